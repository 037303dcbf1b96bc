"""What the locks of one tree say, and of which stages it was still so.

Paths are from the root of the repository, whatever folder a stage runs in.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from dvc.dependency import Dependency, ParamsDependency
from dvc.repo import Repo
from dvc.stage import Stage

from deblur_avatar.pipeline.code import PIPELINE
from deblur_avatar.sweep.costs import stage_of
from tests.equivalence.cases import AREAS, expanded, parameter_values
from tests.equivalence.names import Renaming

PLACES = ("experiments", "stability")  # of pipelines beside the root's


@dataclass(frozen=True)
class Hashed:
    """A file or a folder, as a lock states it."""

    hash_info: Any
    meta: Any


@dataclass(frozen=True)
class Entry:
    """One stage with its item."""

    folder: str
    stage: Stage
    root: Path

    @property
    def name(self) -> str:
        """`experiments/lean:fusion@draw_1-lean`."""
        return f"{self.folder}:{self.stage.name}"

    @property
    def item(self) -> str:
        """What the stage runs over."""
        return self.name.partition("@")[2]

    @property
    def group(self) -> str:
        """The stage without its item."""
        return stage_of(self.name)

    @property
    def locked(self) -> bool:
        """Whether a lock has an entry of this name."""
        return any(out.hash_info for out in self.stage.outs)

    def deps(self) -> list[Dependency]:
        """Dependencies that are files or folders."""
        return [dep for dep in self.stage.deps if not isinstance(dep, ParamsDependency)]

    def params(self) -> list[ParamsDependency]:
        """Dependencies that are parameters, fingerprints of code among them."""
        return [dep for dep in self.stage.deps if isinstance(dep, ParamsDependency)]

    def path(self, output: Any) -> str:
        """A dependency or an output, from the root."""
        return Path(output.fs_path).relative_to(self.root).as_posix()


def entries(tree: Path) -> list[Entry]:
    """All stages of all pipelines, but of the small cases."""
    repo = Repo(str(tree))
    listed = [tree / PIPELINE, *(path for area in PLACES for path in (tree / area).rglob(PIPELINE))]
    folders = [path.parent.relative_to(tree).as_posix() for path in sorted(listed)]
    return [
        Entry(folder, stage, tree)
        for folder in folders
        if not folder.startswith(AREAS)
        for stage in expanded(repo, folder)
    ]


@dataclass
class Recorded:
    """The locks of one commit, read by today's names."""

    tree: Path
    renaming: Renaming
    listed: list[Entry] = field(default_factory=list)
    _known: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.listed = [entry for entry in entries(self.tree) if entry.locked]

    @cached_property
    def by_name(self) -> dict[str, Entry]:
        """Entries by today's names."""
        return {self.renaming.text(entry.name): entry for entry in self.listed}

    @cached_property
    def outs(self) -> dict[str, Hashed]:
        """What stages wrote, by today's paths."""
        return {
            self.renaming.text(entry.path(out)): Hashed(out.hash_info, out.meta)
            for entry in self.listed
            for out in entry.stage.outs
        }

    @cached_property
    def read(self) -> dict[str, list[Hashed]]:
        """What stages read, by today's paths: the same of each file, unless one was stale."""
        found: dict[str, list[Hashed]] = {}
        for entry in self.listed:
            for dep in entry.deps():
                known = found.setdefault(self.renaming.text(entry.path(dep)), [])
                if dep.hash_info not in [hashed.hash_info for hashed in known]:
                    known.append(Hashed(dep.hash_info, dep.meta))
        return found

    def hashed(self, path: str) -> Hashed | None:
        """A file or folder by today's path; None if locks do not know it, or disagree."""
        if path in self.outs:
            return self.outs[path]
        known = self.read.get(path, [])
        return known[0] if len(known) == 1 else None

    def stale(self, entry: Entry) -> str | None:
        """Why an entry did not hold in its own commit; None if it did."""
        return next(self._complaints(entry), None)

    def _complaints(self, entry: Entry) -> Iterator[str]:
        if entry.stage.cmd_changed:
            yield "its command had changed"
        for params in entry.params():
            if params.hash_info.value != parameter_values(params):
                yield f"its parameters in {params.def_path} had changed"
        for dep in entry.deps():
            path = entry.path(dep)
            if dep.exists:
                changed = self._md5(path, dep) != dep.hash_info.value
            else:
                known = self.hashed(self.renaming.text(path))
                changed = known is None or known.hash_info != dep.hash_info
            if changed:
                yield f"it was made from another {path}"
        for out in entry.stage.outs:
            if out.exists and out.workspace_status():
                yield f"{entry.path(out)} was another"

    def _md5(self, path: str, dep: Dependency) -> str:
        """Of a file that many stages read, found once."""
        if path not in self._known:
            self._known[path] = dep.get_hash().value
        return self._known[path]
