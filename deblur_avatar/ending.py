"""Endings of a command: one line and an exit code, whatever ends it early.

Imports nothing that takes time, so that Ctrl-C is answered while torch is loaded, too.
"""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from deblur_avatar.errors import ArtifactError, ConfigError, FittingError

STOPPED: Final = 128 + signal.SIGINT  # the exit code of what a shell's user has stopped
# After the `^C` that a terminal shows.
STOPPED_WORDS: Final = "\nStopped. The same command goes on where it stopped.\n"
STANDARD_ERROR: Final = 2


def exit_code(work: Callable[[], int | None]) -> int:
    """Do a command's work; a mistake of ours keeps its traceback.

    Returns:
        What `work` returns, None being 0; 1 where a caller can mend it (errors.py) and `STOPPED`
        at Ctrl-C, each with one line on standard error.
    """
    try:
        return work() or 0
    except (ConfigError, ArtifactError, FittingError) as error:
        # One line, whatever a parser within says: YAML's shows the place in several.
        sys.stderr.write(f"{type(error).__name__}: {' '.join(str(error).split())}\n")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write(STOPPED_WORDS)
        return STOPPED


def leave_at_once() -> None:
    """End the process at Ctrl-C from now on, while modules are loaded.

    An import that is broken off leaves half a module, in which anything may be raised. A process
    that ignores Ctrl-C, as a shell's background does, or answers it otherwise, goes on doing so.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def raise_again() -> None:
    """Let Ctrl-C raise KeyboardInterrupt again, after `leave_at_once`."""
    if signal.getsignal(signal.SIGINT) is _leave:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Keep Ctrl-C's KeyboardInterrupt until what is within is done; a second one ends the process.

    For what cannot be broken off in the middle, and does not take long.
    """
    answered = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not answered or threading.current_thread() is not threading.main_thread():
        yield
        return
    came = False

    def keep(*_: object) -> None:
        nonlocal came
        came = True
        signal.signal(signal.SIGINT, _leave)

    signal.signal(signal.SIGINT, keep)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if came:
            raise KeyboardInterrupt


def _leave(*_: object) -> None:
    os.write(STANDARD_ERROR, STOPPED_WORDS.encode())
    os._exit(STOPPED)
