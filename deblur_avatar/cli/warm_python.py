"""Client of warm stages: what `python` is for DVC while a pipeline runs (warm_stages.py).

    warm_python.py SOCKET PYTHON SCRIPT [WORD ...]

has the script run by a fork of a process that has torch loaded, with this process's arguments,
folder, environment and standard streams, relays signals to it, and ends as it does. What is no
script, or where nobody listens, is run by PYTHON itself, in place of this process. Imports nothing
of the package, so that it starts at once.
"""

import contextlib
import json
import os
import signal
import socket
import struct
import sys
from types import FrameType

LENGTH = struct.Struct("!I")  # of a request
STATUS = struct.Struct("!i")  # an exit code, or minus the signal that ended the script
RELAYED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main(place: str, python: str, *words: str) -> int:
    """Run a script by the server, or anything by Python itself; returns the exit code."""
    here = os.getcwd()  # noqa: PTH109, pathlib takes longer to load than all else here
    request = json.dumps([words, here, dict(os.environ), ignored()]).encode()
    server = socket.socket(socket.AF_UNIX)
    try:
        if not words or not words[0].endswith(".py"):
            raise OSError("not a script")
        server.connect(place)
        socket.send_fds(server, [LENGTH.pack(len(request))], [0, 1, 2])
    except OSError:  # nobody listens, or a standard stream is closed
        os.execv(python, [python, *words])

    def relay(number: int, _: FrameType | None) -> None:
        with contextlib.suppress(OSError):
            server.send(bytes([number]))

    for number in RELAYED:
        signal.signal(number, relay)
    server.sendall(request)
    answer = server.recv(STATUS.size, socket.MSG_WAITALL)
    if len(answer) < STATUS.size:
        sys.stderr.write("the process that runs stages was killed\n")
        return 128 + signal.SIGKILL
    (status,) = STATUS.unpack(answer)
    return status if status >= 0 else 128 - status


def ignored() -> list[int]:
    """Signals that this process does not hear, as those of a shell's background."""
    return [int(number) for number in RELAYED if signal.getsignal(number) is signal.SIG_IGN]


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
