"""Measured costs: what each stage took when it last ran, here or as its metrics say."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import Any

REMEMBERED = Path(".dvc/tmp/sweep_costs.json")  # this machine's, in no commit
SECONDS, MEMORY_MB = 30.0, 600.0  # of what was never run


@dataclass(frozen=True)
class Cost:
    """Seconds of a task and its peak of memory."""

    seconds: float
    memory_mb: float


class Costs:
    """What tasks are expected to take.

    What was remembered of this very task comes first, then what its metrics say of its last run,
    then the mean of what is remembered of the same stage with other items.

    Args:
        root: of the repository.
    """

    def __init__(self, root: Path) -> None:
        self._path = root / REMEMBERED
        self.remembered: dict[str, float] = _read(self._path)

    def of(self, name: str, written: Iterable[Path]) -> Cost:
        """The expected cost of a task.

        Args:
            name: as DVC addresses it.
            written: files that the stage writes, of which one may say what it cost.
        """
        said = [_read(path) for path in written if "cost" in path.parts]
        memory = next((one["peak_memory_mb"] for one in said if "peak_memory_mb" in one), MEMORY_MB)
        measured = next((one["seconds"] for one in said if "seconds" in one), None)
        seconds = self.remembered.get(name) or measured or self._of_the_like(name) or SECONDS
        return Cost(float(seconds), float(memory))

    def _of_the_like(self, name: str) -> float | None:
        like = [
            took for other, took in self.remembered.items() if stage_of(other) == stage_of(name)
        ]
        return mean(like) if like else None

    def remember(self, took: Mapping[str, float]) -> None:
        """Keep what tasks took, for the next time."""
        self.remembered |= {name: round(seconds, 1) for name, seconds in took.items()}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._path.write_text(f"{json.dumps(self.remembered, indent=1, sort_keys=True)}\n")


def stage_of(name: str) -> str:
    """`fusion` of `experiments/lean/dvc.yaml:fusion@draw_1-lean`."""
    return name.rpartition(":")[2].partition("@")[0]


def _read(path: Path) -> dict[str, Any]:
    """A file of JSON; nothing of one that is not there or is damaged."""
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
