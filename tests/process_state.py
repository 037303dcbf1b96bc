"""What a command switches for its whole process, switched back where it runs beside other tests."""

import ctypes
import io
import logging
import os
import random
import subprocess
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import TypeVar

import numpy as np
import torch

T = TypeVar("T")
THREADS = "DEBLUR_AVATAR_THREADS"  # of native kernels
# Linux's capabilities: the version of their layout, CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH.
CAPABILITIES_3, OVERRIDES = 0x20080522, 1 << 1 | 1 << 2


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


@contextmanager
def own_log() -> Iterator[None]:
    """No handlers of others while a command sets up its log, and its own gone after it."""
    root = logging.getLogger()
    handlers, level, root.handlers = root.handlers, root.level, []
    try:
        yield
    finally:
        root.handlers = handlers
        root.setLevel(level)


def ended_here(
    words: Sequence[str], call: Callable[[], object]
) -> "subprocess.CompletedProcess[str]":
    """What a process of such a command would tell that made this call: exit code and all it wrote.

    The code is what the call returns, if that is a number, or leaves with.
    """
    out, said, code = io.StringIO(), io.StringIO(), 0
    with process_state_kept(), own_log(), redirect_stdout(out), redirect_stderr(said):
        try:
            result = call()
            code = result if isinstance(result, int) else 0
        except SystemExit as end:
            code = end.code
        except Exception:
            traceback.print_exc()
            code = 1
    return subprocess.CompletedProcess(words, code, out.getvalue(), said.getvalue())


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


@contextmanager
def ordinary_user() -> Iterator[None]:
    """Let root be refused what permissions refuse everybody else; Linux alone knows how."""
    if os.geteuid() != 0:
        yield
        return
    libc, header = ctypes.CDLL(None), (ctypes.c_uint32 * 2)(CAPABILITIES_3)
    before, within = (ctypes.c_uint32 * 6)(), (ctypes.c_uint32 * 6)()
    assert libc.capget(header, before) == libc.capget(header, within) == 0
    within[0] &= ~OVERRIDES
    assert libc.capset(header, within) == 0
    try:
        yield
    finally:
        assert libc.capset(header, before) == 0
