"""Warm stages: a pipeline's scripts run in forks of one process that has torch loaded.

Loading torch takes longer than many a stage works. While a pipeline runs, `python` is a client
(warm_python.py) of a server that has loaded the libraries, none of this package's modules: a stage
imports those itself, as ever. A stage is a process with a group of its own, to which the client
relays signals; it dies with the client. Linux alone has all of it; elsewhere Python starts anew.
"""

import atexit
import contextlib
import ctypes
import importlib
import json
import os
import runpy
import select
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import NoReturn

from deblur_avatar.cli import warm_python
from deblur_avatar.cli.warm_python import LENGTH, RELAYED, STATUS

# Libraries that stages wait for, those of torch's optimizers too. None of them starts threads when
# it is imported, but OpenBLAS, which stops them before a fork.
LOADED = (
    "torch", "pydantic", "ruamel.yaml", "cv2", "scipy.spatial", "safetensors.torch", "jaxtyping",
    "tqdm", "torch._dynamo",
)  # fmt: skip
SHIM = '#!/bin/sh\nexec {python} -IS {client} {socket} {python} "$@"\n'
PR_SET_PDEATHSIG = 1  # Linux's prctl.h
STREAMS = 3


def warmed(given: Mapping[str, str]) -> dict[str, str]:
    """Variables by which `python` runs scripts warm; as given where that cannot be."""
    folder = _served() if sys.platform == "linux" else None
    return {**given, "PATH": f"{folder}{os.pathsep}{given['PATH']}"} if folder else dict(given)


@cache
def _served() -> Path | None:
    """A folder with a `python`, of a server that ends with this process; None without a server."""
    scratch = tempfile.TemporaryDirectory(prefix="deblur-avatar-")
    folder = Path(scratch.name)
    words = {
        "python": shlex.quote(sys.executable),
        "client": shlex.quote(warm_python.__file__),
        "socket": shlex.quote(str(folder / "socket")),
    }
    try:
        os.close(os.pidfd_open(os.getpid()))  # refused by old kernels
        listening = socket.socket(socket.AF_UNIX)
        listening.bind(str(folder / "socket"))
        listening.listen()
        (folder / "python").write_text(SHIM.format(**words))
        (folder / "python").chmod(0o700)
        server = subprocess.Popen(
            [sys.executable, "-m", __name__, str(listening.fileno()), str(os.getpid())],
            pass_fds=[listening.fileno()],
        )
    except OSError:  # no place for it: stages start as they do without
        scratch.cleanup()
        return None
    listening.close()

    def stop() -> None:
        server.terminate()
        server.wait()
        scratch.cleanup()

    atexit.register(stop)
    return folder


def serve(listening: socket.socket) -> NoReturn:
    """Fork for each script that is asked for."""
    for number in (signal.SIGINT, signal.SIGHUP):  # a terminal's: meant for clients, who relay them
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for handlers
    for name in LOADED:
        with contextlib.suppress(ImportError):  # the stage that needs it says so
            importlib.import_module(name)
    while True:
        client, _ = listening.accept()
        if os.fork() == 0:
            listening.close()
            _handle(client)
        client.close()


def _handle(client: socket.socket) -> NoReturn:
    """Run one client's script in a process of its own and tell the client how it ended."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    head, streams, _, _ = socket.recv_fds(client, LENGTH.size, STREAMS)
    if len(head) < LENGTH.size or len(streams) < STREAMS:
        os._exit(1)
    (size,) = LENGTH.unpack(head)
    words, folder, environment, ignored = json.loads(client.recv(size, socket.MSG_WAITALL))
    script = os.fork()
    if script == 0:
        client.close()
        _become(streams, folder, environment, ignored)
        _run(words)
    for stream in streams:
        os.close(stream)
    status = _waited_for(script, client)
    with contextlib.suppress(OSError):
        client.sendall(STATUS.pack(status))
    os._exit(0)


def _waited_for(script: int, client: socket.socket) -> int:
    """Relay signals to a script until it ends; without its client it has no business."""
    ended = os.pidfd_open(script)
    while ended not in select.select([client.fileno(), ended], [], [])[0]:
        heard = client.recv(1)
        os.kill(script, heard[0] if heard else signal.SIGKILL)
        if not heard:
            break
    return os.waitstatus_to_exitcode(os.waitpid(script, 0)[1])


def _become(
    streams: list[int], folder: str, environment: dict[str, str], ignored: list[int]
) -> None:
    """Take on what a process has from the one that started it."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    os.setpgid(0, 0)  # a terminal's signals come by way of the client, once
    for stream, standard in zip(streams, range(STREAMS), strict=True):
        os.dup2(stream, standard)
        os.close(stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for number in RELAYED:
        signal.signal(number, signal.SIG_IGN if number in ignored else signal.SIG_DFL)
    if signal.SIGINT not in ignored:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.stdout.reconfigure(line_buffering=os.isatty(1))  # type: ignore[union-attr]


def _run(words: list[str]) -> NoReturn:
    """Run a script as `python SCRIPT WORD ...` does, without taking torch apart at the end."""
    sys.argv, sys.path[0] = words, str(Path(words[0]).resolve().parent)
    code: object = 1
    try:
        runpy.run_path(words[0], run_name="__main__")
        code = 0
    except SystemExit as end:
        code = end.code
    except BaseException:  # as the interpreter: with its traceback
        sys.excepthook(*sys.exc_info())
    if not isinstance(code, int | None):
        sys.stderr.write(f"{code}\n")
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else int(code is not None))


def main(descriptor: str, parent: str) -> None:
    """Serve a socket that was inherited, until the process that began it ends."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() == int(parent):  # and has not ended yet
        serve(socket.socket(fileno=int(descriptor)))


if __name__ == "__main__":
    main(*sys.argv[1:])
