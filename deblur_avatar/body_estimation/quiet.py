"""Silence for libraries that log past every switch of their own."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np


@contextmanager
def quiet_stderr() -> Iterator[None]:
    """Silence MediaPipe's C++ code, which logs past every switch of its own."""
    sys.stderr.flush()
    kept = os.dup(2)
    with open(os.devnull, "w") as nowhere:  # noqa: PTH123
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(kept, 2)
            os.close(kept)


def wait_until_started(detector: Any) -> None:
    """Show a MediaPipe detector a black picture: its threads log whenever they start, which is
    later than the detector is made and no later than its first answer.
    """
    detector.process(np.zeros((16, 16, 3), np.uint8))
