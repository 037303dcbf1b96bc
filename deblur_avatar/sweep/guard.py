"""Guard: run a command, and end all its processes once whoever asked for it is gone.

A killed `dvc repro` leaves its stage running; a second one would write beside it.
"""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from types import FrameType

LOOK = 0.5  # seconds between two looks at the parent


def run(command: Sequence[str]) -> int:
    """Run a command in a group of its own to its end; returns its exit code.

    Its group is killed when this process's parent goes away or this process is told to terminate;
    an interrupt is passed on to the group, which then ends by itself.
    """
    parent = os.getppid()
    process = subprocess.Popen(command, start_new_session=True)

    def passed_on(number: int, frame: FrameType | None) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGINT if number == signal.SIGINT else signal.SIGKILL)

    signal.signal(signal.SIGINT, passed_on)
    signal.signal(signal.SIGTERM, passed_on)
    while True:
        try:
            return process.wait(LOOK)
        except subprocess.TimeoutExpired:
            if os.getppid() != parent:
                passed_on(signal.SIGTERM, None)


if __name__ == "__main__":
    code = run(sys.argv[1:])
    if code < 0:
        with contextlib.suppress(OSError):  # of SIGKILL, which nobody can change
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)  # ends as the command did
    sys.exit(code)
