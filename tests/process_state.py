"""What a stage switches for its whole process, switched back where one runs beside other tests."""

import os
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
import torch

T = TypeVar("T")
THREADS = "DEBLUR_AVATAR_THREADS"  # of native kernels


@contextmanager
def process_state_kept() -> Iterator[None]:
    """Undo `run.stage`'s deterministic mode and global seeds at the end."""
    deterministic = torch.are_deterministic_algorithms_enabled()
    warns = torch.is_deterministic_algorithms_warn_only_enabled()
    fills = torch.utils.deterministic.fill_uninitialized_memory
    states = random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002
    yield
    torch.use_deterministic_algorithms(deterministic, warn_only=warns)
    torch.utils.deterministic.fill_uninitialized_memory = fills
    random.setstate(states[0])
    np.random.set_state(states[1])  # noqa: NPY002
    torch.set_rng_state(states[2])


def by_threads(make: Callable[[], T], *counts: int) -> list[T]:
    """What comes out with each number of threads of torch and of kernels.

    The call leaves both numbers alone.
    """
    before, variable = torch.get_num_threads(), os.environ.get(THREADS)
    try:
        results = []
        for count in counts:
            torch.set_num_threads(count)
            os.environ[THREADS] = str(count)
            results.append(make())
            assert torch.get_num_threads() == count
        return results
    finally:
        torch.set_num_threads(before)
        os.environ.pop(THREADS)
        if variable is not None:
            os.environ[THREADS] = variable
