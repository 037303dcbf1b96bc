"""Locked stages: what `dvc.lock` says that a stage of a folder's pipeline read, and left.

A lock that is missing or damaged says nothing.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

LOCK = "dvc.lock"
# Locks grow far beyond what parameters may be: YAML's parser in C, where there is one, takes 0.3 s
# for that of the repository's root.
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True)
class LockedStage:
    """One entry of a lock; empty where there is none."""

    entry: dict[str, Any]

    def read(self, path: str) -> str | None:
        """The digest of what it read there."""
        return self._digest("deps", path)

    def left(self, path: str) -> str | None:
        """The digest of what it left there."""
        return self._digest("outs", path)

    @property
    def schedule(self) -> str | None:
        """The name of the schedule it was run with, of stages that follow one."""
        try:
            return str(self.entry["params"]["params.yaml"]["schedule"])
        except (KeyError, TypeError):
            return None

    def _digest(self, part: str, path: str) -> str | None:
        try:
            return next(str(one["md5"]) for one in self.entry[part] if one["path"] == path)
        except (KeyError, TypeError, StopIteration):
            return None


def locked_stage(folder: Path, name: str) -> LockedStage:
    """What a folder's lock says of a stage, named as DVC does: `fusion@anna-lean`."""
    try:
        return LockedStage(dict(_parsed((folder / LOCK).read_bytes())["stages"][name]))
    except (OSError, yaml.YAMLError, RecursionError, KeyError, TypeError, ValueError):
        return LockedStage({})


@lru_cache(maxsize=2)  # one lock often says what was fitted and what was prepared
def _parsed(text: bytes) -> Any:
    return yaml.load(text, LOADER)
