"""Ray engine: tasks on the machines of a Ray cluster, which share the repository's folder.

Ray decides where a task runs and says when a machine is gone. Nothing but exit codes and last words
goes through it: artifacts lie in the folder and in DVC's cache.
"""

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import ray
from ray.exceptions import RayError

from deblur_avatar.sweep.commands import end_of, environment_of, guarded, last_words
from deblur_avatar.sweep.scheduler import Clock, Ended
from deblur_avatar.sweep.tasks import Task

BYTES = 1_000_000  # of a megabyte


class RayEngine(Clock):
    """A cluster.

    Args:
        folder: where the repository is, on every machine.
        address: of the cluster's head; None: one is started on this machine.
        environment: of the tasks' processes.
    """

    def __init__(self, folder: Path, address: str | None, environment: Mapping[str, str]) -> None:
        self.folder = folder.resolve()
        self.environment = dict(environment)
        ray.init(address=address, log_to_driver=False, include_dashboard=address is None)
        # What a raylet says Ray prints to standard output, and no setting of its own keeps it away
        # (2.60, `listen_error_messages`); that is the sweep's, whose log and bar hold it already.
        self._aside = redirect_stdout(sys.stderr)
        self._aside.__enter__()
        self._running: dict[Any, tuple[Task, float]] = {}

    def has_room(self, task: Task) -> bool:
        """Whether the cluster's cores are enough for one more; Ray finds the machine."""
        cores = sum(other.cores for other, _ in self._running.values()) + task.cores
        return cores <= ray.cluster_resources().get("CPU", 0)

    def start(self, task: Task) -> None:
        """Hand it to Ray; it is this project's scheduler that tries again."""
        options = {
            "num_cpus": task.cores,
            "memory": int(task.memory_mb * BYTES),
            "max_retries": 0,
            "name": task.name,
        }
        variables = environment_of(task, self.environment)
        call = _call.options(**options).remote(guarded(task), str(self.folder), variables)
        self._running[call] = (task, self.seconds())

    def wait(self, seconds: float) -> Ended | None:
        """The next one that ends; one whose machine is gone has ended, too."""
        if not self._running:  # what was lost waits to be begun again
            time.sleep(seconds)
            return None
        ended, _ = ray.wait(list(self._running), num_returns=1, timeout=seconds)
        if not ended:
            return None
        task, began = self._running.pop(ended[0])
        took = self.seconds() - began
        try:
            code, said, where, took = ray.get(ended[0])
        except RayError as error:  # the worker's process or machine
            return Ended(task.name, "lost", f"{type(error).__name__}: {error}", "gone", took)
        return Ended(task.name, end_of(code, said), said, where, took)

    def stop(self) -> None:
        """End what runs and leave the cluster; one that was started here ends."""
        for reference in self._running:
            ray.cancel(reference, force=True)
        self._running.clear()
        ray.shutdown()
        self._aside.__exit__(None, None, None)


@ray.remote
def _call(
    command: list[str], folder: str, environment: dict[str, str]
) -> tuple[int, str, str, float]:
    """Run a command on the machine that Ray has chosen: exit code, last words, machine, seconds."""
    clock = Clock()
    began = clock.seconds()
    with tempfile.TemporaryFile() as log:
        done = subprocess.run(
            command, cwd=folder, env=os.environ | environment, stdin=subprocess.DEVNULL,
            stdout=log, stderr=subprocess.STDOUT, check=False,
        )  # fmt: skip
        node = ray.get_runtime_context().get_node_id()[:8]
        where = f"{socket.gethostname()}/{node}"
        return done.returncode, last_words(log), where, clock.seconds() - began
