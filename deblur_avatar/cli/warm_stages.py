"""Warm stages: a pipeline's scripts run in forks of one process that has torch loaded.

Loading torch takes longer than many a stage works. While a pipeline runs, `python` is a client
(warm_python.py) of a server that has loaded the libraries; the package's modules a stage imports
itself, as ever. A stage is a process with a group of its own, to which the client relays signals,
as a terminal's reach a group; both die with the client. Linux alone has all of it; elsewhere, and
where there is no server, Python starts anew.
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
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import NoReturn

from deblur_avatar.cli import warm_python
from deblur_avatar.cli.warm_python import LENGTH, RELAYED, STATUS, STREAMS, TAKEN

# Libraries that stages wait for, those of torch's optimizers too. None of them starts threads when
# it is imported, but OpenBLAS, which stops them before a fork.
LOADED = (
    "torch", "pydantic", "ruamel.yaml", "cv2", "scipy.spatial", "safetensors.torch", "jaxtyping",
    "tqdm", "torch._dynamo",
)  # fmt: skip
SHIM = '#!/bin/sh\nexec {python} -IS {client} {socket} {python} "$@"\n'
PR_SET_PDEATHSIG = 1  # Linux's prctl.h
# A terminal's, which reach all processes of a command: stages hear them from their clients, once.
OF_TERMINALS = (signal.SIGINT, signal.SIGHUP, signal.SIGTSTP)


def warmed(given: Mapping[str, str]) -> dict[str, str]:
    """Variables by which `python` runs scripts warm; as given where that cannot be."""
    folder = _served() if sys.platform == "linux" else None
    return {**given, "PATH": f"{folder}{os.pathsep}{given['PATH']}"} if folder else dict(given)


@cache
def _served() -> Path | None:
    """A folder with a `python`, of a server that ends with this process; None without a server."""
    try:
        os.close(os.pidfd_open(os.getpid()))  # refused by old kernels
        folder = Path(tempfile.mkdtemp(prefix="deblur-avatar-"))
    except OSError:
        return None
    words = {
        "python": shlex.quote(sys.executable),
        "client": shlex.quote(warm_python.__file__),
        "socket": shlex.quote(str(folder / "socket")),
    }
    try:
        with socket.socket(socket.AF_UNIX) as listening:
            listening.bind(str(folder / "socket"))
            listening.listen()
            (folder / "python").write_text(SHIM.format(**words))
            (folder / "python").chmod(0o700)
            told = map(str, (listening.fileno(), os.getpid(), folder))
            with _blocked(OF_TERMINALS):  # until the server does not hear them
                server = subprocess.Popen(
                    [sys.executable, "-P", "-m", __name__, *told], pass_fds=[listening.fileno()]
                )
    except OSError:  # no place for it: stages start as they do without
        shutil.rmtree(folder, ignore_errors=True)
        return None

    def stop() -> None:
        server.terminate()
        server.wait()

    atexit.register(stop)
    return folder


@contextlib.contextmanager
def _blocked(signals: Iterable[int]) -> Iterator[None]:
    """Let signals wait; processes that begin meanwhile let them wait on."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def serve(listening: socket.socket) -> NoReturn:
    """Fork for each script that is asked for."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for handlers
    for name in LOADED:
        with contextlib.suppress(Exception):  # the stage that needs it says so
            importlib.import_module(name)
    while True:
        # A client that nobody answers begins anew.
        with contextlib.suppress(OSError), listening.accept()[0] as client:
            if os.fork() == 0:
                listening.close()
                _handle(client)


def _handle(client: socket.socket) -> NoReturn:
    """Run one client's script in a process of its own and tell the client how it ended."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        head, streams, _, _ = socket.recv_fds(client, LENGTH.size, len(STREAMS))
        (size,) = LENGTH.unpack(head)
        words, folder, environment, deaf = json.loads(client.recv(size, socket.MSG_WAITALL))
        client.sendall(TAKEN)
        # Signals that come before the script can hear them wait for it.
        signal.pthread_sigmask(signal.SIG_BLOCK, RELAYED)
        script = os.fork()
    except Exception:  # the client is gone
        os._exit(1)
    if script == 0:
        client.close()
        _become(streams, folder, environment, deaf)
        _run(words)
    with contextlib.suppress(OSError):  # the script may have done so already, and more
        os.setpgid(script, script)
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
        number = heard[0] if heard else signal.SIGKILL
        with contextlib.suppress(ProcessLookupError):
            os.kill(script, number) if number == signal.SIGTERM else os.killpg(script, number)
        if not heard:
            break
    return os.waitstatus_to_exitcode(os.waitpid(script, 0)[1])


def _become(streams: list[int], folder: str, environment: dict[str, str], deaf: list[int]) -> None:
    """Take on what a process has from the one that started it."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    os.setpgid(0, 0)
    for stream, standard in zip(streams, STREAMS, strict=True):
        os.dup2(stream, standard)
        os.close(stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for number in (*RELAYED, signal.SIGTSTP):
        signal.signal(number, signal.SIG_IGN if number in deaf else signal.SIG_DFL)
    if signal.SIGINT not in deaf:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.stdout.reconfigure(line_buffering=os.isatty(1))  # type: ignore[union-attr]


def _run(words: list[str]) -> NoReturn:
    """Run a script as `python SCRIPT WORD ...` does, without taking torch apart at the end."""
    sys.argv = words
    if not os.environ.get("PYTHONSAFEPATH"):
        sys.path.insert(0, str(Path(words[0]).resolve().parent))
    code: object = 1
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, RELAYED)
        runpy.run_path(words[0], run_name="__main__")
        code = 0
    except SystemExit as end:
        code = end.code
    except BaseException as error:  # as the interpreter: with its traceback
        sys.excepthook(*sys.exc_info())
        code = -signal.SIGINT if isinstance(error, KeyboardInterrupt) else 1
    if not isinstance(code, int | None):
        sys.stderr.write(f"{code}\n")
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    if code == -signal.SIGINT:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    os._exit(code & 0xFF if isinstance(code, int) else int(code is not None))


def main(descriptor: str, parent: str, folder: str) -> None:
    """Serve a socket that was inherited, until the process that began it ends."""

    def leave(*_: object) -> NoReturn:
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(0)

    signal.signal(signal.SIGTERM, leave)
    for number in OF_TERMINALS:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, OF_TERMINALS)
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != int(parent):  # which has ended already
        leave()
    serve(socket.socket(fileno=int(descriptor)))


if __name__ == "__main__":
    main(*sys.argv[1:])
