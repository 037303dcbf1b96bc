"""Locks written anew: entries for those stages of which an older lock can be believed.

Small cases prove that code does the same. That what lies in git and in caches was made by it is
another matter: an entry is believed if it held in its own commit, its parameters say the same now,
and each file that the stage reads and writes is known to it or unchanged.
"""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from dvc.stage.serialize import to_single_stage_lockfile
from dvc.utils.serialize import dump_yaml
from dvc_data.hashfile.hash import DEFAULT_ALGORITHM

from deblur_avatar.sweep.costs import stage_of
from tests.equivalence.cases import parameter_values, parameters, words
from tests.equivalence.comparison import compared_values, leaves
from tests.equivalence.coverage import Kind
from tests.equivalence.names import Renaming
from tests.equivalence.recorded import Entry, Hashed, Recorded

LOCK = "dvc.lock"
ALWAYS_RUN = "code"


@dataclass(frozen=True)
class Proven:
    """What small cases say."""

    stages: frozenset[str]  # that do the same, byte for byte
    kinds: frozenset[Kind]  # of which no case was compared
    changed: tuple[str, ...]  # patterns of what is said to do something else


def is_named(name: str, patterns: Iterable[str]) -> bool:
    """Whether a stage, or a stage with its item, is among those named."""
    short = name.rpartition(":")[2]
    return any(fnmatch(short, pattern) or stage_of(name) == pattern for pattern in patterns)


class _LeftOutError(Exception):
    """Why an entry cannot be believed."""


@dataclass
class Relocked:
    """What becomes of each stage, by name."""

    kept: list[str]  # the present lock's entry holds
    vouched: dict[str, list[str]]  # parameters and values of one version alone
    left_out: dict[str, str]  # why


class Relocking:
    """Finds what can be vouched for, and writes locks of it."""

    def __init__(self, root: Path, base: Recorded, proven: Proven, tracked: set[str]) -> None:
        self.root = root
        self.base = base
        self.proven = proven
        self.tracked = tracked

    @property
    def renaming(self) -> Renaming:
        """Between the two."""
        return self.base.renaming

    def relock(self, present: list[Entry]) -> Relocked:
        """Write the locks of all pipelines that had one; what is left out is in none."""
        done = Relocked([], {}, {})
        folders = {self.renaming.text(entry.folder) for entry in self.base.listed}
        for folder in sorted(folders):
            believed = {}
            for entry in (entry for entry in present if entry.folder == folder):
                if entry.group != ALWAYS_RUN and self._judged(entry, done):
                    believed[entry.stage.name] = to_single_stage_lockfile(entry.stage)
            content = {"schema": "2.0", "stages": believed}
            dump_yaml(str(self.root / folder / LOCK), content)
        return done

    def _judged(self, entry: Entry, done: Relocked) -> bool:
        if holds(entry):
            done.kept.append(entry.name)
            return True
        try:
            done.vouched[entry.name] = self._vouched(entry)
        except _LeftOutError as reason:
            done.left_out[entry.name] = str(reason)
            return False
        return True

    def _vouched(self, entry: Entry) -> list[str]:
        """Fill an entry's hashes; what one version alone has is returned."""
        if entry.group not in self.proven.stages:
            raise _LeftOutError("no small case says that its code does the same")
        if is_named(entry.name, self.proven.changed):
            raise _LeftOutError("it is said to do something else")
        for kind in words(entry.stage):
            if tuple(kind) in self.proven.kinds:
                raise _LeftOutError(f"no small case compared {kind[0]}: {kind[1]}")
        origin = self.base.by_name.get(entry.name) or self._split_from(entry)
        if stale := self.base.stale(origin):
            raise _LeftOutError(f"{origin.name} was not up to date at BASE: {stale}")
        listed = list(self._compared_parameters(origin, entry))
        for dep in entry.deps():
            _state(dep, self._read(entry.path(dep), dep, origin))
        for out in entry.stage.outs:
            path = entry.path(out)
            if self._in_git(path):
                listed += self._measured(path, origin)
                _save(out)
            else:
                _state(out, self._written(path, origin))
        for params in entry.params():
            params.save()
        return listed

    def _split_from(self, entry: Entry) -> Entry:
        """Of a new stage: the one that measured all its values."""
        for origin in self.base.listed:
            if self.renaming.text(origin.folder) == entry.folder and (
                self.renaming.text(origin.item) == entry.item
            ):
                values = self._values(origin)
                outs = [entry.path(out) for out in entry.stage.outs]
                if all(
                    self._in_git(path) and _leaf_values(self.root / path) <= values for path in outs
                ):
                    return origin
        raise _LeftOutError("BASE's lock has no entry of it")

    def _compared_parameters(self, origin: Entry, entry: Entry) -> Iterator[str]:
        before = {
            self.renaming.text(key): self.renaming.content(value)
            for key, value in parameters(origin.stage).items()
        }
        after = parameters(entry.stage)
        for key in before.keys() & after.keys():
            if before[key] != after[key]:
                raise _LeftOutError(f"{key} was {before[key]}, is {after[key]}")
        yield from sorted(before.keys() ^ after.keys())

    def _in_git(self, path: str) -> bool:
        return path in self.tracked

    def _values(self, origin: Entry) -> set[tuple[str, str]]:
        """All that a stage measured, by last key; with the words of today."""
        found: set[tuple[str, str]] = set()
        for out in origin.stage.outs:
            if out.exists and out.fs_path.endswith(".json"):
                content = self.renaming.content(json.loads(Path(out.fs_path).read_text()))
                found |= _last_values(content)
        return found

    def _read(self, path: str, dep: Any, origin: Entry) -> Hashed:
        """The hash of what a stage reads."""
        known = self.base.hashed(path)
        if known is None:
            raise _LeftOutError(f"locks do not know {path}, or disagree")
        if not self._in_git(path):
            return known
        _save(dep)
        if dep.hash_info != known.hash_info:
            self._same_values(path, origin)
        return Hashed(dep.hash_info, dep.meta)

    def _written(self, path: str, origin: Entry) -> Hashed:
        written = {self.renaming.text(origin.path(out)) for out in origin.stage.outs}
        if path not in written:
            raise _LeftOutError(f"{origin.name} did not write {path}")
        return self.base.outs[path]

    def _measured(self, path: str, origin: Entry) -> list[str]:
        """What is said in one version alone of a file of metrics that is otherwise the same."""
        known = self.base.outs.get(path)
        if known is None:
            if not path.endswith(".json"):
                raise _LeftOutError(f"BASE has no {path}")
            missing = _leaf_values(self.root / path) - self._values(origin)
            if missing:
                raise _LeftOutError(f"{path}: BASE measured no {sorted(missing)[0]}")
            return []
        return self._same_values(path, origin)

    def _same_values(self, path: str, origin: Entry) -> list[str]:
        """Refuse a file that says something else than the file of BASE."""
        old, new = self._file_of_base(path), self.root / path
        if old is None or not old.is_file():
            raise _LeftOutError(f"{path} is not what it was")
        if old.read_bytes() == new.read_bytes():
            return []
        if new.suffix != ".json":
            raise _LeftOutError(f"{path} is not what it was")
        before, after = json.loads(old.read_text()), json.loads(new.read_text())
        values = compared_values(before, after, self.renaming)
        if values.differences or not values.common:
            raise _LeftOutError(f"{path}: {[*values.differences, 'nothing in common'][0]}")
        return [f"metrics of {origin.group}: {text}" for text in values.one_sided]

    def _file_of_base(self, path: str) -> Path | None:
        for entry in self.base.listed:
            for out in entry.stage.outs:
                if self.renaming.text(entry.path(out)) == path:
                    return Path(out.fs_path)
        return None


def holds(entry: Entry) -> bool:
    """Whether the present lock's entry is of this very code, parameters and files."""
    return (
        entry.locked
        and not entry.stage.cmd_changed
        and all(params.hash_info.value == parameter_values(params) for params in entry.params())
        and not any(
            file.exists and file.workspace_status() for file in [*entry.deps(), *entry.stage.outs]
        )
    )


def _state(output: Any, hashed: Hashed) -> None:
    """Say what a path holds; of one that the present lock lacks, DVC expects an older hash."""
    output.hash_name = hashed.hash_info.name
    output.hash_info, output.meta = hashed.hash_info, hashed.meta


def _save(output: Any) -> None:
    """Hash what lies there, likewise."""
    output.hash_name = DEFAULT_ALGORITHM
    output.save()


def _leaf_values(path: Path) -> set[tuple[str, str]]:
    return _last_values(json.loads(path.read_text())) if path.is_file() else set()


def _last_values(content: Any) -> set[tuple[str, str]]:
    return {((key or ("",))[-1], str(value)) for key, value in leaves(content, costs=True)}
