"""One hostile input after the other, read in a child process that may do little.

The child has so much address space and so much time for each input; an audit hook notes every
command, connection and file written while a reader is at work. What may happen is that the file is
read, with finite numbers, or refused with an error of our own. Anything else is a failure, and so
is memory that was asked for in vain, even where a reader turned that into an error of our own.
"""

import contextlib
import dataclasses
import math
import multiprocessing
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deblur_avatar.errors import ArtifactError, ConfigError

MAX_MEMORY = 1 << 30  # bytes that reading one input may take; what the readers promise
MAX_ADDRESSES = 3 << 30  # bytes of address space: libraries reserve more than they use
MAX_SECONDS = 10.0  # of processor time for one input
MAX_WAITING = 60.0  # seconds by the clock for one input: other programs run as well
FORBIDDEN = (
    "os.system", "os.exec", "os.posix_spawn", "os.fork", "os.forkpty", "os.spawn", "os.startfile",
    "subprocess.Popen", "socket.connect", "socket.bind", "socket.getaddrinfo", "urllib.Request",
    "os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.chmod", "os.link", "os.symlink",
    "shutil.rmtree", "pickle.find_class",
)  # fmt: skip


@dataclasses.dataclass
class Tally:
    """What became of one reader's inputs."""

    reader: str
    inputs: int = 0
    read: int = 0
    refused: int = 0
    peak_mb: float = 0.0  # the most memory that one input took
    slowest_s: float = 0.0
    failures: dict[str, str] = dataclasses.field(default_factory=dict)  # where: what came
    deaths: int = 0  # how often the process ended
    finished: bool = False
    functions: list[str] = dataclasses.field(default_factory=list)  # that read the good file


class TooSlow(BaseException):
    """Not an `Exception`, so that no reader takes it for damage of its file."""


Tell = Callable[[Tally], None]


def in_child(work: Callable[[Tell], Tally], tally: Tally, seconds: float) -> Tally:
    """Run `work` in a fork of this process; a child that dies or hangs is a failure too.

    Args:
        work: takes what is to be called with its tally before each input.
        tally: what is known so far.
        seconds: by the clock, from one telling to the next.

    Returns:
        The last tally, `finished` if the child came to its end.
    """
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    child = context.Process(target=_child, args=(work, sender))
    child.start()
    sender.close()
    reason = f"nothing came back for {seconds:.0f} s"
    try:
        while receiver.poll(seconds):
            tally = receiver.recv()
            if tally.finished:
                return tally
    except (EOFError, ConnectionResetError):
        child.join()
        reason = f"the process ended with exit code {child.exitcode}"
    finally:
        child.kill()
        child.join()
    tally.failures[f"input {tally.inputs}"] = reason
    tally.deaths += 1
    return tally


def _child(work: Callable[[Tell], Tally], sender: Any) -> None:
    limit = _status("VmSize") + MAX_ADDRESSES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGPROF, _too_slow)
    signal.signal(signal.SIGALRM, _too_slow)
    warnings.simplefilter("ignore")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # native libraries complain there
    sys.addaudithook(_note)
    try:
        tally = work(sender.send)
    except BaseException as error:
        # Not of the reader but of the campaign; hypothesis adds pages of notes to what was raised.
        where = "".join(traceback.format_tb(error.__traceback__)[-2:])
        tally = Tally("", failures={"child": f"{where}{type(error).__name__}: {error}"[-1500:]})
    sender.send(dataclasses.replace(tally, finished=True))


def try_input(read: Callable[[], object], tally: Tally, acts: list[str]) -> None:
    """Read one input and enter in the tally what became of it."""
    acts.clear()
    Path("/proc/self/clear_refs").write_text("5")  # peak memory counts anew
    before, begin = _status("VmRSS"), time.process_time()
    tally.inputs += 1
    try:
        signal.setitimer(signal.ITIMER_PROF, MAX_SECONDS)
        try:
            with _watched(acts):
                result = read()
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.setitimer(signal.ITIMER_REAL, 0)
        tally.read += 1
        wrong = _not_finite(result)
        if wrong:
            tally.failures.setdefault(f"not finite: {wrong}", "a value that is not finite was read")
    except (ConfigError, ArtifactError) as error:
        tally.refused += 1
        if _memory_in(error):
            tally.failures.setdefault(_place(error), f"memory was asked for in vain: {error}"[:400])
    except TooSlow as error:
        limits = f"over {MAX_SECONDS:.0f} s of processor time, or {MAX_WAITING:.0f} s of waiting"
        tally.failures.setdefault(_place(error), limits)
    except Exception as error:
        tally.failures.setdefault(_place(error), f"{type(error).__name__}: {error}"[:400])
    took = (_status("VmHWM") - before) / 2**20
    tally.peak_mb = max(tally.peak_mb, took)
    tally.slowest_s = max(tally.slowest_s, time.process_time() - begin)
    if took > MAX_MEMORY / 2**20:
        tally.failures.setdefault("memory", f"{took:.0f} MB for one input")
    for act in acts:
        tally.failures.setdefault(act, "was done while a file was read")


@contextlib.contextmanager
def noted_functions(found: list[str]) -> Iterator[None]:
    """Enter the package's functions that run, each as `pipeline/report.py:read_results`."""
    names: set[str] = set()

    def note(frame: Any, event: str, _: object) -> None:
        if event == "call" and "/deblur_avatar/" in frame.f_code.co_filename:
            file = frame.f_code.co_filename.split("/deblur_avatar/")[-1]
            names.add(f"{file}:{frame.f_code.co_name}")

    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(None)
    found += sorted(names)


_watching: list[str] | None = None


@contextlib.contextmanager
def _watched(acts: list[str]) -> Iterator[None]:
    global _watching
    _watching = acts
    try:
        yield
    finally:
        _watching = None


def _note(event: str, arguments: tuple[Any, ...]) -> None:
    """The audit hook: what a reader does besides reading."""
    if _watching is None:
        return
    writes = event == "open" and isinstance(arguments[1], str) and set(arguments[1]) & set("wax+")
    if event in FORBIDDEN or writes:
        _watching.append(f"{event} {arguments!r:.80}")


def _too_slow(*_: object) -> None:
    raise TooSlow


def _status(field: str) -> int:
    """A field of this process' status, bytes."""
    text = Path("/proc/self/status").read_text()
    return int(text.split(f"{field}:")[1].split()[0]) * 1024


def _place(error: BaseException) -> str:
    """The innermost line of ours that an error went through."""
    frames = [
        f for f in traceback.extract_tb(error.__traceback__) if "/deblur_avatar/" in f.filename
    ]
    if not frames:
        return "outside of the package"
    last = frames[-1]
    return f"{last.filename.split('/deblur_avatar/')[-1]}:{last.lineno} in {last.name}"


def _memory_in(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, MemoryError) or "allocat" in str(error):
            return True
        error = error.__cause__ or error.__context__
    return False


def _not_finite(value: Any, depth: int = 0) -> str:
    """The kind of the first part of a result that is not finite; empty if there is none."""
    if depth > 8:
        return ""
    if isinstance(value, torch.Tensor):
        finite = bool(torch.isfinite(value).all()) if value.is_floating_point() else True
    elif isinstance(value, np.ndarray):
        finite = bool(np.isfinite(value).all()) if value.dtype.kind in "fc" else True
    elif isinstance(value, float):
        finite = math.isfinite(value)
    else:
        parts = vars(value) if dataclasses.is_dataclass(value) else value
        parts = dict(enumerate(parts)) if isinstance(parts, list | tuple) else parts
        items = parts.items() if isinstance(parts, dict) else ()
        found = ((key, _not_finite(item, depth + 1)) for key, item in items)
        return next((f"{key} {below}".strip() for key, below in found if below), "")
    return "" if finite else type(value).__name__
