"""Task graph: stages that are out of date, what each waits for, and what it will cost.

Conventions. Seconds are those of a task on its own cores; a graph is a dictionary of tasks by name,
each after those that it needs.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Task:
    """One stage with its item, or one experiment.

    name: as DVC addresses it: `experiments/lean/dvc.yaml:fusion@draw_1-lean`.
    needs: names of the tasks that it waits for.
    seconds: what it is expected to take.
    memory_mb: its expected peak.
    cores: that it is given.
    command: that runs it in the repository's folder.
    """

    name: str
    needs: frozenset[str]
    seconds: float
    memory_mb: float
    cores: int
    command: tuple[str, ...]


Tasks = Mapping[str, Task]


def remaining_path(tasks: Tasks) -> dict[str, float]:
    """Of each task the seconds of the longest path from its start to the end of all."""
    after: dict[str, float] = dict.fromkeys(tasks, 0.0)
    path = {}
    for name in reversed(list(tasks)):
        task = tasks[name]
        path[name] = task.seconds + after[name]
        for needed in task.needs & tasks.keys():
            after[needed] = max(after[needed], path[name])
    return path


def critical_path(tasks: Tasks) -> float:
    """Seconds that no number of machines can shorten."""
    return max(remaining_path(tasks).values(), default=0.0)
