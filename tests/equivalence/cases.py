"""The small cases of one tree: its own pipelines, as DVC expands them, run without DVC's cache.

`experiments/cases` and `stability/cases` say what is run, on footage that two trees share.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import networkx
from dvc.dependency import ParamsDependency
from dvc.fs import localfs
from dvc.repo import Repo
from dvc.repo.graph import build_graph
from dvc.stage import Stage
from dvc.utils.serialize import load_path

from deblur_avatar.errors import ConfigError
from deblur_avatar.pipeline.code import FINGERPRINTS, PIPELINE
from deblur_avatar.sweep.costs import stage_of

MISSING: Final = object()
AREAS = ("experiments/cases", "stability/cases")
# Pages show what a clock says; they are never compared, hence never run.
REPORTS = ("code", "report", "ablations", "proof", "proof_strips", "stability_report")
FOOTAGE_VARIABLE, VIDEOS_VARIABLE = "DEBLUR_AVATAR_CASES", "POSE2SIM_ROOT"
VIDEOS = "../shared/data/pose2sim_single"  # from the root, where parameters look for them
WORKER = Path(__file__).with_name("worker.py")


@dataclass(frozen=True)
class Job:
    """One stage with its item."""

    name: str  # <folder from the root>:<stage>@<item>
    folder: str  # where its command runs
    argv: list[str]  # after `python`
    needs: list[str]  # names of jobs
    outs: list[str]  # from the root
    words: list[list[str]]  # each of its parameters' last key and value

    @property
    def stage(self) -> str:
        """The stage, without folder and item."""
        return stage_of(self.name)


def pipelines(tree: Path, areas: Sequence[str] = AREAS) -> list[str]:
    """The folders of all pipelines of small cases, from the root."""
    found = [path for area in areas for path in sorted((tree / area).rglob(PIPELINE))]
    return [path.parent.relative_to(tree).as_posix() for path in found]


def expanded(repo: Repo, folder: str) -> list[Stage]:
    """A pipeline's stages with what their lock says, in the order of its file."""
    return list(repo.stage.load_all(str(Path(repo.root_dir, folder, PIPELINE))))


def jobs_of(tree: Path) -> list[Job]:
    """All small cases of a tree, each after those that it needs."""
    repo = Repo(str(tree))
    jobs = []
    for folder in pipelines(tree):
        graph = build_graph(expanded(repo, folder))  # from a stage to what it needs
        for stage in networkx.dfs_postorder_nodes(graph):
            if stage_of(stage.name) not in REPORTS:
                jobs.append(_job(stage, folder, list(graph.successors(stage)), tree))
    return jobs


def _job(stage: Stage, folder: str, needed: list[Stage], tree: Path) -> Job:
    program, *argv = shlex.split(stage.cmd)
    if program != "python":
        raise ValueError(f"{folder}: {stage.name} runs {program}; small cases run python")
    return Job(
        name=f"{folder}:{stage.name}",
        folder=stage.wdir,
        argv=argv,
        needs=[f"{folder}:{other.name}" for other in needed if stage_of(other.name) not in REPORTS],
        outs=[Path(out.fs_path).relative_to(tree).as_posix() for out in stage.outs],
        words=[list(word) for word in words(stage)],
    )


def words(stage: Stage) -> set[tuple[str, str]]:
    """The last key and the value of each parameter that a stage depends on."""
    return {(re.sub(r"\[.*|.*\.", "", key), str(value)) for key, value in parameters(stage).items()}


def parameters(stage: Stage) -> dict[str, Any]:
    """Every value that a stage depends on, by its full key; no fingerprints of code."""
    asked = [dep for dep in stage.deps if isinstance(dep, ParamsDependency)]
    return dict(
        leaf
        for dependency in asked
        if Path(dependency.fs_path).name != FINGERPRINTS
        for key, value in parameter_values(dependency).items()
        for leaf in _leaves(value, key)
    )


def parameter_values(dependency: ParamsDependency) -> dict[str, Any]:
    """What a file says now of the keys that a stage asks for; nothing of those it lacks."""
    found = {}
    path = Path(dependency.fs_path)
    content = _loaded(path, path.stat().st_mtime_ns) if path.is_file() else {}
    for key in dependency.params:
        value = content
        for name in key.split("."):
            value = value.get(name, MISSING) if isinstance(value, dict) else MISSING
        if value is not MISSING:
            found[key] = value
    return found


@lru_cache
def _loaded(path: Path, written: int) -> Any:
    """A file's content as of when it was written: many stages ask for the same."""
    return load_path(str(path), localfs)


def _leaves(content: Any, key: str) -> Iterator[tuple[str, Any]]:
    if isinstance(content, dict) and content:
        for name, value in content.items():
            yield from _leaves(value, f"{key}.{name}")
    elif isinstance(content, list) and content:
        for number, value in enumerate(content):
            yield from _leaves(value, f"{key}[{number}]")
    else:
        yield key, content


def start(jobs: list[Job], tree: Path, scratch: Path, environment: dict[str, str]) -> Any:
    """Start a process that runs a tree's jobs, with one thread.

    Args:
        jobs: of the tree.
        tree: whose code runs.
        scratch: for logs (`<number>.log`) and outcomes.
        environment: further variables.
    """
    scratch.mkdir()
    listed = [
        asdict(job) | {"log": str(scratch / f"{number}.log")} for number, job in enumerate(jobs)
    ]
    (scratch / "jobs.json").write_text(json.dumps(listed))
    command = [sys.executable, "-P", str(WORKER), "jobs.json", "outcomes.json"]
    variables = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(tree)} | environment
    variables.pop("DEBLUR_AVATAR_CHECK_SHAPES", None)  # costs time and changes nothing
    return subprocess.Popen(command, cwd=scratch, env=variables)


def failures(jobs: list[Job], scratch: Path) -> dict[str, str]:
    """Jobs that did not end well: the last that each said, or that it waited for another."""
    outcomes = json.loads((scratch / "outcomes.json").read_text())
    return {
        job.name: "what it needs failed"
        if outcomes[job.name] is None
        else _last_line(scratch / f"{number}.log")
        for number, job in enumerate(jobs)
        if outcomes[job.name] != 0
    }


def _last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines() if log.is_file() else []
    return lines[-1] if lines else "it said nothing"


def footage_variables(footage: Path, root: Path) -> dict[str, str]:
    """Where small cases find footage: what is written for them, and real videos.

    Raises:
        ConfigError: if the videos are not there, which cases would find out a quarter hour later.
    """
    videos = Path(os.environ.get(VIDEOS_VARIABLE) or (root / VIDEOS).resolve())
    if not videos.is_dir():
        raise ConfigError(
            f"no folder {videos}: small cases read the courtyard's videos; name it in "
            f"{VIDEOS_VARIABLE} (CONTRIBUTING.md)"
        )
    return {FOOTAGE_VARIABLE: str(footage), VIDEOS_VARIABLE: str(videos)}
