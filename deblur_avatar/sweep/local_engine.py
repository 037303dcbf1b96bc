"""Local engine: tasks as processes of this machine, as many as its cores and memory allow."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from deblur_avatar.sweep.commands import end_of, environment_of, guarded, last_words
from deblur_avatar.sweep.scheduler import Clock, Ended
from deblur_avatar.sweep.tasks import Task

LOOK = 0.05  # seconds between two looks at the processes
PATIENCE = 10.0  # seconds that a process that is asked to end may take


@dataclass
class _Running:
    task: Task
    process: "subprocess.Popen[bytes]"
    log: IO[bytes]
    began: float


class LocalEngine(Clock):
    """Processes of this machine.

    Args:
        folder: where the repository is.
        cores: how many tasks of one core may run at a time.
        memory_mb: what they may take together.
        environment: of the processes.
    """

    def __init__(
        self, folder: Path, cores: int, memory_mb: float, environment: Mapping[str, str]
    ) -> None:
        self.folder = folder
        self.cores = cores
        self.memory_mb = memory_mb
        self.environment = environment
        self._running: dict[str, _Running] = {}

    def has_room(self, task: Task) -> bool:
        """Whether cores and memory are free."""
        tasks = [running.task for running in self._running.values()]
        cores = sum(other.cores for other in tasks) + task.cores
        memory = sum(other.memory_mb for other in tasks) + task.memory_mb
        return cores <= self.cores and memory <= self.memory_mb

    def start(self, task: Task) -> None:
        """Begin it as a process that ends when this one does."""
        log = tempfile.TemporaryFile()  # noqa: SIM115, closed when the task has ended
        process = subprocess.Popen(
            guarded(task), cwd=self.folder, stdin=subprocess.DEVNULL, stdout=log,
            stderr=subprocess.STDOUT, env=environment_of(task, self.environment),
            start_new_session=True,
        )  # fmt: skip
        self._running[task.name] = _Running(task, process, log, self.seconds())

    def wait(self, seconds: float) -> Ended | None:
        """The first process found to have ended."""
        until = self.seconds() + seconds
        while True:
            for name, running in self._running.items():
                code = running.process.poll()
                if code is not None:
                    del self._running[name]
                    return self._ended(running, code)
            if self.seconds() >= until:
                return None
            time.sleep(LOOK)

    def _ended(self, running: _Running, code: int) -> Ended:
        with running.log as log:
            said = last_words(log)
        took = self.seconds() - running.began
        return Ended(running.task.name, end_of(code, said), said, "here", took)

    def stop(self) -> None:
        """Ask all processes to end, so that DVC gives its locks back, and wait for them."""
        for running in self._running.values():
            running.process.send_signal(signal.SIGINT)
        for running in self._running.values():
            try:
                running.process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                running.process.terminate()  # the guard kills its group
                running.process.wait()
            running.log.close()
        self._running.clear()


def this_machine(folder: Path, cores: int) -> LocalEngine:
    """This machine, with all of its memory and this process's environment.

    Args:
        folder: where the repository is.
        cores: how many tasks of one core may run at a time.
    """
    memory_mb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
    return LocalEngine(folder, cores, memory_mb, os.environ)


def cores_here() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
