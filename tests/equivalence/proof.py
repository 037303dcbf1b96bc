"""Proves that two versions of the code do the same, on small cases that both run."""

import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from deblur_avatar.errors import ConfigError
from tests.equivalence.cases import Job, failures, jobs_of, start
from tests.equivalence.comparison import Comparison, Side, compare
from tests.equivalence.coverage import Kind, exercised
from tests.equivalence.locks import Proven, is_named
from tests.equivalence.names import Renaming

GENERATOR = "deblur_avatar/pipeline/code.py"  # of fingerprints; older trees have none


class RefusedError(ConfigError):
    """Locks may not be written: what differs, failed or has no case, a line each."""


@dataclass(frozen=True)
class Trees:
    """Two versions, side by side in a folder that goes."""

    then: Path
    now: Path
    scratch: Path


def git(root: Path, *arguments: str) -> str:
    """What git says; an error if it refuses."""
    command = ["git", "-C", str(root), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ConfigError(f"git {arguments[0]}: {done.stderr.strip()}")
    return done.stdout


@contextmanager
def trees(root: Path, base: str) -> Iterator[Trees]:
    """A commit's tree and a copy of the present one, with all that git does not ignore."""
    with tempfile.TemporaryDirectory(prefix="relock-") as folder:
        there = Trees(Path(folder, "then"), Path(folder, "now"), Path(folder, "scratch"))
        there.scratch.mkdir()
        git(root, "worktree", "add", "--detach", str(there.then), base)
        try:
            for name in git(root, "ls-files", "-co", "--exclude-standard", "-z").split("\0"):
                if name and (root / name).is_file():
                    (there.now / name).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy(root / name, there.now / name)
            git(there.now, "init", "-q")  # DVC wants one
            if (there.then / GENERATOR).is_file():
                refreshed(there.then)
            yield there
        finally:
            git(root, "worktree", "remove", "--force", str(there.then))


def refreshed(tree: Path) -> None:
    """Write a tree's fingerprints by its own code."""
    module = GENERATOR.removesuffix(".py").replace("/", ".")
    variables = os.environ | {"PYTHONPATH": str(tree)}
    subprocess.run(
        [sys.executable, "-m", module], cwd=tree, env=variables, check=True, stdout=sys.stderr
    )


@dataclass(frozen=True)
class Question:
    """What is to be proven.

    Args:
        renaming: between the two versions.
        changed: stages that are said to do something else, or patterns of their names with items
            (`evaluate@*-cubic`).
        kinds: which small cases must run.
        variables: of the environment, for footage.
    """

    renaming: Renaming
    changed: tuple[str, ...]
    kinds: frozenset[Kind]
    variables: dict[str, str]


def prove(there: Trees, asked: Question, say: Callable[[str], None]) -> Proven:
    """Run both versions' small cases and compare what they wrote.

    Raises:
        RefusedError: if a byte differs, a case fails or a kind has none.
    """
    then, now = Side(there.then, jobs_of(there.then)), Side(there.now, jobs_of(there.now))
    missing = asked.kinds - exercised(now.jobs)
    if missing:
        raise RefusedError("\n".join(f"no small case has {key}: {word}" for key, word in missing))
    then = _run(there, then, now, asked.variables, say)
    found = compare(then, now, asked.renaming)
    for line, count in sorted(Counter(found.one_sided).items()):
        say(f"not compared: {line} ({count})")
    refused = [line for job, line in found.differences if not is_named(job, asked.changed)]
    if refused:
        raise RefusedError("\n".join(refused))
    return _proven(found, now.jobs, asked)


def _run(
    there: Trees, then: Side, now: Side, variables: dict[str, str], say: Callable[[str], None]
) -> Side:
    """Run both sides at once; what failed before is not compared, what fails now is refused."""
    running = [
        start(side.jobs, side.tree, there.scratch / side.tree.name, variables)
        for side in (then, now)
    ]
    try:
        for process, side in zip(running, (then, now), strict=True):
            if process.wait():
                raise RefusedError(f"the small cases of {side.tree.name} could not be run at all")
    finally:
        for process in running:
            process.kill()  # the other, or both at an interrupt
    failed = failures(now.jobs, there.scratch / now.tree.name)
    if failed:
        raise RefusedError("\n".join(f"{name} failed: {why}" for name, why in failed.items()))
    before = failures(then.jobs, there.scratch / then.tree.name)
    for name, why in before.items():
        say(f"{name}: failed before: {why}")
    return Side(then.tree, [job for job in then.jobs if job.name not in before])


def _proven(found: Comparison, jobs: list[Job], asked: Question) -> Proven:
    compared = [job for job in jobs if job.name in found.compared]
    same = {job.stage for job in compared if not is_named(job.name, asked.changed)}
    kinds = frozenset(asked.kinds - exercised(compared))
    return Proven(frozenset(same - found.renamed), kinds, asked.changed)
