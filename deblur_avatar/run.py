"""Stage context: arguments, seed, device, threads, log, progress, measurements."""

import argparse
import contextlib
import ctypes
import hashlib
import inspect
import logging
import os
import random
import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, TypeVar

import numpy as np
import torch
from tqdm import tqdm

from deblur_avatar.ending import exit_code, raise_again
from deblur_avatar.errors import ConfigError

T = TypeVar("T")

MALLOPT_TRIM_THRESHOLD, MALLOPT_MMAP_THRESHOLD = -1, -3  # glibc's malloc.h
KEPT_BYTES = 1 << 30  # more than any stage frees at once
MAX_THREADS = 1024  # more is a slip of the keyboard
THREADS_THAT_PAY = 4  # what is left to torch's one thread is a third of a step by then

# Names that seeds are derived from, by today's words: what was renamed draws what it drew before.
SEED_NAMES = {"agnostic": "blind", "learning_curve": "timeline"}

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Context:
    """Where a stage runs and what it draws from.

    The generator is the CPU's on any device: what is drawn is drawn there and taken to the device,
    so that a fit draws the same numbers wherever it runs.
    """

    device: torch.device
    generator: torch.Generator
    seed: int


def command(main: Callable[..., None]) -> None:
    """Run a stage's `main` with its parameters as command-line options, all required.

    What ends it early becomes one line and an exit code (ending.py).
    """
    parser = argparse.ArgumentParser(description=inspect.getdoc(main))
    for name, parameter in inspect.signature(main).parameters.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=parameter.annotation, required=True)
    arguments = vars(parser.parse_args())
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    raise_again()  # all is loaded
    code = exit_code(lambda: main(**arguments))
    if code:
        raise SystemExit(code)


@contextmanager
def stage(name: str, item: str, seed: int) -> Iterator[Context]:
    """Log a stage's start and end, seed it, choose its device and number of threads.

    Each stage and item derives its own seed, so adding a stage does not reshuffle the others. Torch
    computes with one thread, since its sums depend on how many there are; the sums of native
    kernels do not, and these take `kernel_threads`. On a GPU, sums come in any order, which no
    setting of torch's changes for the rasterizer there; two runs differ by rounding.

    Raises:
        ConfigError: if there is no such device here, the number of threads is none, or memory
            is full.
    """
    kernel_threads()  # says so early if they are asked for wrongly
    torch.set_num_threads(1)
    derived = derive_seed(seed, name, item)
    device = chosen_device()
    generator = torch.Generator().manual_seed(derived)
    random.seed(derived)
    np.random.seed(derived)  # noqa: NPY002, third parties draw from it
    torch.manual_seed(derived)
    # As `torch.use_deterministic_algorithms`, which loads torch's compiler for seconds first.
    torch.set_deterministic_debug_mode("error" if device.type == "cpu" else "default")
    torch.backends.cudnn.allow_tf32 = False  # float32 has all its digits on a GPU, too
    # A debugging aid that costs time.
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    _keep_freed_memory()
    logger.info("%s %s: start, device %s, seed %d", name, item, device, derived)
    begin = time.perf_counter()
    try:
        yield Context(device=device, generator=generator, seed=derived)
    except torch.OutOfMemoryError as error:  # of a GPU
        raise ConfigError(
            f"{name} {item}: this GPU's memory is full ({str(error).partition('. ')[0]}); choose a "
            "smaller schedule, end what else runs on it, or set DEBLUR_AVATAR_DEVICE=cpu"
        ) from error
    except MemoryError as error:
        raise ConfigError(
            f"{name} {item}: this machine's memory is full ({error}); take fewer or smaller frames "
            "(clip.frames, clip.image_height), or end what else runs on it"
        ) from error
    took = time.perf_counter() - begin
    logger.info("%s %s: done in %.1f s, %.0f MB", name, item, took, peak_memory_mb())


def chosen_device() -> torch.device:
    """Where to compute: `DEBLUR_AVATAR_DEVICE`, or a GPU where there is one and gsplat, or the CPU.

    Raises:
        ConfigError: if there is no such device here.
    """
    named = os.environ.get("DEBLUR_AVATAR_DEVICE")
    if named is None:
        if not torch.cuda.is_available():
            return torch.device("cpu")
        if find_spec("gsplat") is None:  # the rasterizer for GPUs (rendering/cuda.py)
            logger.info("there is a GPU, but no gsplat: pip install 'deblur-avatar[cuda]' uses it")
            return torch.device("cpu")
        named = "cuda"
    try:
        device = torch.device(named)
        torch.Generator(device)  # refused where there is no such device
    except RuntimeError as error:
        raise ConfigError(f"DEBLUR_AVATAR_DEVICE: {error}") from error
    return device


def kernel_threads() -> int:
    """How many threads a native kernel takes, whose results are the same for any number.

    `DEBLUR_AVATAR_THREADS`, or as many as this process has cores, but no more than pay.

    Raises:
        ConfigError: if the variable is no such number.
    """
    text = os.environ.get("DEBLUR_AVATAR_THREADS")
    if text is None:
        return min(len(os.sched_getaffinity(0)), THREADS_THAT_PAY)
    if not (text.isdecimal() and 0 < int(text) <= MAX_THREADS):
        raise ConfigError(f"DEBLUR_AVATAR_THREADS: wanted 1 to {MAX_THREADS}, got {text!r:.40}")
    return int(text)


@contextmanager
def one_thread() -> Iterator[None]:
    """Let torch compute with one thread, whose results are the same on any number of cores.

    With several, torch's products and sums add in an order that depends on how many there are.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def in_threads(function: Callable[..., T], *items: Iterable[Any]) -> list[T]:
    """Call a function with each of the items, side by side; returns results in their order.

    For what leaves the interpreter to others while it works: OpenCV, NumPy, coding of pictures.

    Args:
        function: whose result does not depend on what runs beside it.
        items: an argument each, equally many.
    """
    with ThreadPoolExecutor(kernel_threads()) as workers:
        return list(workers.map(lambda each: function(*each), zip(*items, strict=True)))


def _keep_freed_memory() -> None:
    """Ask glibc not to return large blocks to the system at once.

    A fitting step frees and takes the same few megabytes hundreds of times; fetching them anew each
    time costs a page fault per 4 kB (measured: an eighth of a step). Other systems are left alone.
    """
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.mallopt(MALLOPT_TRIM_THRESHOLD, KEPT_BYTES)
        libc.mallopt(MALLOPT_MMAP_THRESHOLD, KEPT_BYTES)


def derive_seed(seed: int, *names: str) -> int:
    """Derive one seed per stage and item, the same on every machine (unlike `hash`).

    Parts of names, between dashes, count by their first spelling (`SEED_NAMES`).
    """
    keys = ["-".join(SEED_NAMES.get(part, part) for part in name.split("-")) for name in names]
    digest = hashlib.sha256("/".join([str(seed), *keys]).encode()).digest()
    return int.from_bytes(digest[:4], "big")


def progress(items: Iterable[T], description: str, total: int | None = None) -> Iterable[T]:
    """Show how far a loop is, on a terminal only."""
    return tqdm(items, desc=description, total=total, disable=not sys.stderr.isatty(), leave=False)


def fitting_progress(description: str, last: int) -> Callable[[int, Mapping[str, float]], None]:
    """A callback for fitting loops: a bar on a terminal, a log line every tenth of the way."""
    bar = tqdm(total=last, desc=description, disable=not sys.stderr.isatty(), leave=False)
    every = max(last // 10, 1)

    def report(iteration: int, losses: Mapping[str, float]) -> None:
        bar.update(iteration - bar.n)
        if iteration % every == 0 or iteration == last:
            terms = " ".join(f"{name} {value:.4f}" for name, value in losses.items())
            logger.info("%s %d/%d: %s", description, iteration, last, terms)
        if iteration == last:
            bar.close()

    return report


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far, megabytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
