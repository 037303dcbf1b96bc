"""Client of warm stages: what `python` is for DVC while a pipeline runs (warm_stages.py).

    warm_python.py SOCKET PYTHON SCRIPT [WORD ...]

has the script run by a fork of a process that has torch loaded, with this process's arguments,
folder, environment and standard streams, relays signals to it, and ends as it does. What is no
script, or where nobody answers, is run by PYTHON itself, in place of this process. Imports nothing
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
from typing import NoReturn

LENGTH = struct.Struct("!I")  # of a request
STATUS = struct.Struct("!i")  # an exit code, or minus the signal that ended the script
TAKEN = b"+"  # what the server says when it has a request
RELAYED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
KILLED = (
    "this was killed, as a system does whose memory is full: take fewer or smaller frames "
    "(clip.frames, clip.image_height), or end what else runs on it\n"
)
STREAMS = (0, 1, 2)  # standard input, output and error


def main(place: str, python: str, *words: str) -> int:
    """Run a script by the server, or anything by Python itself; returns the exit code."""

    def begin_anew() -> NoReturn:
        for number in (*RELAYED, signal.SIGTSTP):
            if number not in deaf:
                signal.signal(number, signal.SIG_DFL)
        os.execv(python, [python, *words])

    deaf = [number for number in RELAYED if signal.getsignal(number) is signal.SIG_IGN]
    if signal.SIGINT not in deaf:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # until there is somebody to tell
    here = os.getcwd()  # noqa: PTH109, pathlib takes longer to load than all else here
    request = json.dumps([words, here, dict(os.environ), deaf]).encode()
    try:
        for stream in STREAMS:
            os.fstat(stream)
        if not words or not words[0].endswith(".py") or not os.path.isfile(words[0]):  # noqa: PTH113
            begin_anew()
        server = socket.socket(socket.AF_UNIX)
        server.connect(place)
        socket.send_fds(server, [LENGTH.pack(len(request))], STREAMS)
        server.sendall(request)
    except OSError:  # nobody listens, or a standard stream is closed
        begin_anew()

    def relay(number: int, _: FrameType | None = None) -> None:
        with contextlib.suppress(OSError):
            server.send(bytes([number]))

    def pause(*_: object) -> None:
        relay(signal.SIGSTOP)
        os.kill(os.getpid(), signal.SIGSTOP)
        relay(signal.SIGCONT)

    for number in RELAYED:
        signal.signal(number, relay)
    signal.signal(signal.SIGTSTP, pause)
    if _received(server, len(TAKEN)) != TAKEN:
        begin_anew()
    answer = _received(server, STATUS.size)
    if len(answer) < STATUS.size:
        sys.stderr.write("the process that runs stages was killed\n")
        return 128 + signal.SIGKILL
    (status,) = STATUS.unpack(answer)
    if status == -signal.SIGKILL:
        sys.stderr.write(KILLED)
    return status if status >= 0 else 128 - status


def _received(server: socket.socket, size: int) -> bytes:
    """So many bytes, or fewer if nobody sends more."""
    try:
        return server.recv(size, socket.MSG_WAITALL)
    except OSError:
        return b""


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
