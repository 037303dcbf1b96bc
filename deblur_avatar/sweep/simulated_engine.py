"""Simulated engine: what a sweep would take on so many workers, without running anything."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from deblur_avatar.sweep.scheduler import Ended, Progress, work_off
from deblur_avatar.sweep.tasks import Task, Tasks, critical_path


class SimulatedEngine:
    """Workers of one core each, on a clock that jumps from end to end.

    Args:
        workers: how many cores there are.
        start: seconds that starting a task takes its core.
    """

    def __init__(self, workers: int, start: float) -> None:
        self.workers = workers
        self.start_seconds = start
        self._now = 0.0
        self._ends: dict[str, tuple[float, Task]] = {}

    def has_room(self, task: Task) -> bool:
        """Whether a worker is free."""
        return sum(other.cores for _, other in self._ends.values()) + task.cores <= self.workers

    def start(self, task: Task) -> None:
        """Note when it will end."""
        self._ends[task.name] = (self._now + self.start_seconds + task.seconds, task)

    def wait(self, seconds: float) -> Ended | None:
        """Jump to the next end."""
        if not self._ends:
            return None
        name = min(self._ends, key=lambda task: (self._ends[task][0], task))
        self._now, task = self._ends.pop(name)
        return Ended(name, "done", "", "simulated", task.seconds)

    def seconds(self) -> float:
        """Simulated ones."""
        return self._now

    def stop(self) -> None:
        """Nothing runs."""


@dataclass(frozen=True)
class Forecast:
    """What a number of workers makes of a sweep.

    seconds: until the last task ends.
    speedup: against one worker.
    efficiency: share of the workers' time that is spent in tasks.
    """

    workers: int
    seconds: float
    speedup: float
    efficiency: float


def forecasts(tasks: Tasks, workers: Iterable[int], start: float) -> list[Forecast]:
    """The sweep on each number of workers.

    Args:
        tasks: the graph.
        workers: numbers of cores.
        start: seconds that starting a task costs.
    """
    alone = sum((start + task.seconds) * task.cores for task in tasks.values())
    found = []
    for count in workers:
        engine = SimulatedEngine(count, start)
        work_off(tasks, engine, _unseen)
        seconds = engine.seconds()
        speedup = alone / seconds if seconds else math.nan
        found.append(Forecast(count, seconds, speedup, speedup / count))
    return found


def table(tasks: Tasks, found: Iterable[Forecast]) -> list[str]:
    """Lines of a Markdown table, and the critical path."""
    lines = ["| workers | hours | speed-up | efficiency |", "|---:|---:|---:|---:|"]
    lines += [
        f"| {one.workers} | {one.seconds / 3600:.2f} | {one.speedup:.1f} | {one.efficiency:.0%} |"
        for one in found
    ]
    hours = critical_path(tasks) / 3600
    return [*lines, f"{len(tasks)} tasks; the longest chain of them takes {hours:.2f} hours."]


def _unseen(progress: Progress, ended: Ended | None) -> None:
    """Nobody watches."""
