"""Stages as tasks: DVC's graph of the repository, cut down to what is asked for and out of date."""

import os
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import networkx
from dvc.exceptions import DvcException
from dvc.repo import Repo
from dvc.stage import PipelineStage
from dvc.utils.serialize import dump_yaml, load_yaml

from deblur_avatar.errors import ConfigError
from deblur_avatar.sweep.commands import REPRO, python_first
from deblur_avatar.sweep.costs import Costs
from deblur_avatar.sweep.tasks import Task

LOCK = "dvc.lock"
PAGE = "index.html"  # of a report: an output, or in a folder that is one


class Pipelines:
    """The stages that some targets stand on, and they themselves.

    Args:
        root: of the repository.
        targets: pipelines (`experiments/lean/dvc.yaml`) or stages of them (`...:fusion@a`).

    Raises:
        ConfigError: if DVC cannot read a pipeline, or knows no such target.
    """

    def __init__(self, root: Path, targets: Sequence[str]) -> None:
        self.root = root
        try:
            self._repo = Repo(str(root))
            self._graph = self._repo.index.graph  # from a stage to what it needs
            asked = [stage for target in targets for stage in self._repo.stage.collect(target)]
        except DvcException as error:
            raise ConfigError(f"DVC: {error}") from error
        wanted = {
            stage for one in asked for stage in (one, *networkx.descendants(self._graph, one))
        }
        # In the order that `dvc repro` works them off; where it is asked for less than half of a
        # repository's stages, its order is that of a set, another in each process, and this is not.
        part = networkx.DiGraph()
        part.add_nodes_from(stage for stage in self._graph if stage in wanted)
        part.add_edges_from(edge for edge in self._graph.edges if edge[0] in wanted)
        self.stages: list[PipelineStage] = list(networkx.dfs_postorder_nodes(part))

    def run_always_changed(self) -> None:
        """Run the stages that always run; all others stand on what they write.

        Raises:
            ConfigError: if one fails; DVC has said why.
        """
        for stage in (stage for stage in self.stages if stage.always_changed):
            done = subprocess.run(
                [*REPRO, "--quiet", stage.addressing], cwd=self.root,
                env=python_first(os.environ), check=False,
            )  # fmt: skip
            if done.returncode:
                raise ConfigError(f"stage {stage.addressing} failed; what it said stands above")

    def tasks(self, costs: Costs, cores: int = 1) -> dict[str, Task]:
        """What is out of date, and what stands on that."""
        stale: dict[str, Task] = {}
        with self._repo.lock:
            for stage in self.stages:
                if stage.always_changed:
                    continue
                needs = frozenset(
                    needed.addressing for needed in self._graph.successors(stage)
                ) & frozenset(stale)
                if needs or stage.changed():
                    cost = costs.of(stage.addressing, _files(stage))
                    name = stage.addressing
                    command = (*REPRO, name)
                    stale[name] = Task(name, needs, cost.seconds, cost.memory_mb, cores, command)
        return stale

    def pages(self) -> list[Path]:
        """The pages of reports that there are; pages of single items lie in the cache."""
        outs = (out for stage in self.stages for out in stage.outs if not out.use_cache)
        places = (Path(out.fs_path) for out in outs)
        pages = (path if path.name == PAGE else path / PAGE for path in places)
        return [page.relative_to(self.root.resolve()) for page in pages if page.is_file()]

    def locks(self) -> dict[Path, list[str]]:
        """The entries of every lock beside these pipelines, in their order."""
        folders = dict.fromkeys(Path(stage.path).parent for stage in self.stages)
        return {folder / LOCK: list(_entries(folder / LOCK)) for folder in folders}

    def put_in_order(self, before: Mapping[Path, Sequence[str]]) -> None:
        """Write locks as if `dvc repro` had run one stage after the other.

        DVC appends what is new as it ends; in a sweep that is another order each time.

        Args:
            before: what `locks` said then.
        """
        rank = {(stage.path, stage.name): number for number, stage in enumerate(self.stages)}
        for lock, known in before.items():
            pipeline = str(lock.with_name("dvc.yaml"))
            entries = _entries(lock)
            new = [name for name in entries if name not in known]
            new.sort(key=lambda name: rank.get((pipeline, name), len(rank)))
            wanted = [*(name for name in known if name in entries), *new]
            if wanted != list(entries):
                content = load_yaml(str(lock))
                content["stages"] = {name: entries[name] for name in wanted}
                dump_yaml(str(lock), content)


def _entries(lock: Path) -> dict[str, Any]:
    return dict(load_yaml(str(lock)).get("stages", {})) if lock.is_file() else {}


def _files(stage: PipelineStage) -> Iterator[Path]:
    """What a stage writes, of files."""
    yield from (Path(out.fs_path) for out in stage.outs if out.fs_path.endswith(".json"))


def pipelines_below(root: Path, folder: str) -> list[str]:
    """All pipelines in a folder of the repository and below it, as paths from `root`.

    Raises:
        ConfigError: if there is none, or the folder is not of the repository.
    """
    inside, top = (root / folder).resolve(), root.resolve()
    if not inside.is_relative_to(top):
        raise ConfigError(f"{folder} is no folder of {top}: start the sweep in its own repository")
    found = sorted(inside.rglob("dvc.yaml"))
    if not found:
        raise ConfigError(f"no dvc.yaml in {folder} or below it: what is to be swept?")
    return [path.relative_to(top).as_posix() for path in found]


def changed_since_commit(root: Path) -> bool:
    """Whether a file that git knows is another than the commit's."""
    command = ["git", "status", "--porcelain", "--untracked-files=no"]
    done = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True)
    return bool(done.stdout.strip())
