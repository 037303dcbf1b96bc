"""Scheduler: work tasks off on an engine, those first that most still waits for.

A task whose process or machine went away is begun again, somewhere; its stage goes on from its
checkpoint. One that failed by itself is not: what needs it is left, everything else goes on.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, Protocol

from deblur_avatar.sweep.tasks import Task, Tasks, remaining_path

WAIT = 1.0  # seconds between two looks at the clock while nothing ends
# Seconds before a lost task is begun again, times how often it was: what its process has left
# behind may still be ending, and DVC begins no stage that another process holds.
PAUSE = 3.0

End = Literal["done", "failed", "lost"]


@dataclass(frozen=True)
class Ended:
    """How a task ended: `lost` is one whose process or machine went away.

    said: the last of what it wrote.
    where: the machine.
    seconds: that it ran.
    """

    name: str
    end: End
    said: str
    where: str
    seconds: float


class Engine(Protocol):
    """Where tasks run."""

    def has_room(self, task: Task) -> bool:
        """Whether it could begin at once."""

    def start(self, task: Task) -> None:
        """Begin it."""

    def wait(self, seconds: float) -> Ended | None:
        """The next one that ends, or None if none does in this time."""

    def seconds(self) -> float:
        """What its clock says."""

    def stop(self) -> None:
        """End all that runs, and give everything back."""


class Clock:
    """The wall's."""

    def seconds(self) -> float:
        """Since some moment."""
        return time.perf_counter()


@dataclass
class Progress:
    """What has become of the tasks.

    failed: what they said last, by name.
    left: names of tasks that need one that failed.
    took: seconds of each that is done.
    """

    tasks: Tasks
    running: dict[str, float] = field(default_factory=dict)  # when each began
    done: set[str] = field(default_factory=set)
    failed: dict[str, str] = field(default_factory=dict)
    left: set[str] = field(default_factory=set)
    lost: dict[str, int] = field(default_factory=dict)  # how often
    again: dict[str, float] = field(default_factory=dict)  # when a lost one may begin
    took: dict[str, float] = field(default_factory=dict)

    @property
    def waiting(self) -> list[str]:
        """Names of tasks that have not begun and may."""
        gone = {*self.running, *self.done, *self.failed, *self.left}
        return [name for name in self.tasks if name not in gone]

    def seconds_left(self, workers: int) -> float:
        """What is left at the expected costs, if that many tasks run at a time."""
        waiting = sum(self.tasks[name].seconds for name in self.waiting)
        running = sum(self.tasks[name].seconds / 2 for name in self.running)
        return (waiting + running) / max(workers, 1)


Watch = Callable[[Progress, Ended | None], None]


def work_off(tasks: Tasks, engine: Engine, watch: Watch, retries: int = 2) -> Progress:
    """Run every task after those it needs; stops the engine whatever happens.

    Args:
        tasks: the graph.
        engine: where they run.
        watch: is told at every end, and at least every few seconds.
        retries: how often a lost task is begun again.
    """
    order = remaining_path(tasks)
    progress = Progress(tasks)
    try:
        while progress.waiting or progress.running:
            for name in sorted(_ready(progress, engine.seconds()), key=lambda ready: -order[ready]):
                if engine.has_room(tasks[name]) or not progress.running:
                    progress.running[name] = engine.seconds()
                    engine.start(tasks[name])
            ended = engine.wait(WAIT)
            if ended:
                _note(progress, ended, retries)
                if ended.end == "lost":
                    pause = PAUSE * progress.lost[ended.name]
                    progress.again[ended.name] = engine.seconds() + pause
            watch(progress, ended)
    finally:
        engine.stop()
    return progress


def _ready(progress: Progress, now: float) -> list[str]:
    tasks = progress.tasks
    return [
        name
        for name in progress.waiting
        if all(needed in progress.done for needed in tasks[name].needs & tasks.keys())
        and progress.again.get(name, now) <= now
    ]


def _note(progress: Progress, ended: Ended, retries: int) -> None:
    """Write down an end, and what it means for those that need the task."""
    name = ended.name
    del progress.running[name]
    if ended.end == "done":
        progress.done.add(name)
        progress.took[name] = ended.seconds
        return
    if ended.end == "lost":
        progress.lost[name] = progress.lost.get(name, 0) + 1
        if progress.lost[name] <= retries:
            return
    progress.failed[name] = ended.said
    for other, task in progress.tasks.items():
        if task.needs & (progress.failed.keys() | progress.left):
            progress.left.add(other)
