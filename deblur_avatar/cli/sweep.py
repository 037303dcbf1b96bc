"""Run pipelines' stages as tasks, many at a time: on this machine's cores or on a Ray cluster.

  deblur-avatar sweep experiments/lean                      all cores of this machine
  deblur-avatar sweep experiments/proof --engine ray --address auto
  deblur-avatar sweep experiments/proof --plan 1 2 10 50    what so many workers would take
  deblur-avatar sweep experiments/sweep -S methods.lean.trajectory.motion.knot_frames=2,4

What is out of date is run, what it stands on first; DVC's locks and the metrics end as if
`dvc repro` had run one stage after the other. With -S every combination of values becomes one of
DVC's experiments, of what is committed. A task whose process or machine goes away is begun again
and goes on from its checkpoint. Stopped, the same command goes on. docs/scaling.md
"""

import argparse
import logging
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout
from tqdm import tqdm

from deblur_avatar.cli.running_dvc import check_checkout
from deblur_avatar.errors import ConfigError
from deblur_avatar.pipeline.code import refresh
from deblur_avatar.sweep.costs import Costs
from deblur_avatar.sweep.grid import grid, tasks_of
from deblur_avatar.sweep.local_engine import cores_here, this_machine
from deblur_avatar.sweep.scheduler import Ended, Engine, Progress, work_off
from deblur_avatar.sweep.simulated_engine import forecasts, table
from deblur_avatar.sweep.stages import Pipelines, changed_since_commit, pipelines_below
from deblur_avatar.sweep.tasks import Task, Tasks

logger = logging.getLogger(__name__)

LOCK = Path(".dvc/tmp/sweep.lock")
EXPERIMENT_SECONDS = 300.0  # of one whose parts nobody has measured
START_SECONDS = 3.0  # of DVC and the stage's imports
LINES = 6  # of what a failed task said last


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument("what", nargs="+", help="folders with pipelines, or DVC's targets")
    parser.add_argument(
        "-S", "--set", action="append", default=[], metavar="KEY=VALUE,...", dest="values",
        help="an experiment for every combination; of one folder or target",
    )  # fmt: skip
    parser.add_argument("--engine", choices=("local", "ray"), default="local")
    parser.add_argument("--address", help="of a Ray cluster's head; without it one starts here")
    parser.add_argument(
        "--at-once", type=int, help="tasks at a time; default: this machine's cores"
    )
    parser.add_argument("--retries", type=int, default=2, help="of a task that was killed")
    parser.add_argument(
        "--plan", nargs="*", type=int, metavar="WORKERS",
        help="say what it would take on so many workers, and stop",
    )  # fmt: skip


def run(asked: argparse.Namespace) -> int:
    """Work off what is out of date, or a grid; returns 0, or 1 if a task failed."""
    root = Path()
    check_checkout(root)
    _check(asked)
    targets = targets_of(root, asked.what)
    cores = asked.at_once or cores_here()
    workers = [cores] if asked.plan == [] else asked.plan
    return sweep(
        root, targets, cores, grid(asked.values), workers=workers, retries=asked.retries,
        engine=lambda: _engine(asked, root, cores),
    )  # fmt: skip


def sweep(
    root: Path, targets: Sequence[str], cores: int, combinations: Sequence[dict[str, str]] = (),
    *, engine: Callable[[], Engine], workers: Sequence[int] | None = None, retries: int = 2,
) -> int:  # fmt: skip
    """Plan, run, put the locks in order, say what became of it.

    Args:
        root: of the repository.
        targets: pipelines or stages of them.
        cores: how many tasks are expected to run at a time.
        combinations: of parameters; none, or that of no parameters, for the targets as they are.
        engine: starts what runs them.
        workers: numbers of workers to make a forecast for, and stop; None: run.
        retries: of a task that was killed.

    Returns:
        0, or 1 if a task failed.

    Raises:
        ConfigError: if there are no such targets, or another sweep works here.
    """
    with _alone(root):
        refresh(root)
        pipelines, costs = Pipelines(root, targets), Costs(root)
        pipelines.run_always_changed()
        tasks = pipelines.tasks(costs)
        if any(combinations):
            tasks = _experiments(root, targets, combinations, tasks)
        for line in table(tasks, forecasts(tasks, workers or [cores], START_SECONDS)):
            logger.info("%s", line)
        if workers is not None:
            return 0
        before = pipelines.locks()
        try:
            with _shown(tasks, cores) as watch:
                progress = work_off(tasks, engine(), watch, retries)
        finally:
            pipelines.put_in_order(before)
        costs.remember(progress.took)
        return _told(progress, pipelines.pages())


def _experiments(
    root: Path, targets: Sequence[str], combinations: Sequence[dict[str, str]], stale: Tasks
) -> dict[str, Task]:
    """A grid's tasks; what is out of date as it stands would be run by each."""
    if len(targets) != 1:
        raise ConfigError(f"-S is of one pipeline or stage, got {len(targets)}: {list(targets)}")
    if stale:
        raise ConfigError(
            f"-S: {len(stale)} stages are out of date as they stand, and each experiment would "
            "run them: sweep them first, without -S, and commit"
        )
    if changed_since_commit(root):
        raise ConfigError("-S: experiments start from what is committed; commit your changes first")
    return tasks_of(root, targets[0], combinations, EXPERIMENT_SECONDS)


def targets_of(root: Path, what: list[str]) -> list[str]:
    """DVC's targets as they are, of folders all pipelines in them."""
    targets: list[str] = []
    for word in what:
        targets += pipelines_below(root, word) if (root / word).is_dir() else [word]
    return targets


def _check(asked: argparse.Namespace) -> None:
    if asked.address and asked.engine != "ray":
        raise ConfigError("--address is of a Ray cluster: say --engine ray, too")
    for name, least in (("at_once", 1), ("retries", 0)):
        value = getattr(asked, name)
        if value is not None and value < least:
            option = name.replace("_", "-")
            raise ConfigError(f"--{option}: wanted {least} or more, got {value}")
    for workers in asked.plan or ():
        if workers < 1:
            raise ConfigError(f"--plan: wanted numbers of workers from 1, got {workers}")


def _engine(asked: argparse.Namespace, root: Path, cores: int) -> Engine:
    if asked.engine == "local":
        return this_machine(root, cores)
    try:
        from deblur_avatar.sweep.ray_engine import RayEngine
    except ModuleNotFoundError:
        raise ConfigError(
            "--engine ray needs Ray, which is not installed: pip install 'deblur-avatar[cluster]'"
        ) from None
    return RayEngine(root, asked.address, os.environ)


@contextmanager
def _alone(root: Path) -> Iterator[None]:
    """No second sweep in this folder: two would run the same stages."""
    path = root / LOCK
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise ConfigError(
            f"another sweep works in {root.resolve()}; wait for it, or stop it"
        ) from None
    try:
        yield
    finally:
        lock.release()


@contextmanager
def _shown(tasks: Tasks, cores: int) -> Iterator["_Shown"]:
    """A bar of tasks done, with what runs and the time left, and a line for each that failed; in a
    log, where no bar can move, a line for each end.
    """
    with tqdm(total=len(tasks), unit="task", dynamic_ncols=True, disable=None) as bar:
        yield _Shown(bar, cores)


class _Shown:
    def __init__(self, bar: "tqdm[None]", cores: int) -> None:
        self.bar = bar
        self.cores = cores
        self.out = sys.stdout  # whatever an engine prints goes elsewhere

    def __call__(self, progress: Progress, ended: Ended | None) -> None:
        """Tell of an end, and of where things stand."""
        if ended and ended.end != "done":
            again = "" if ended.name in progress.failed else "; it is begun again"
            said = f"{ended.name} {ended.end} ({ended.where}){again}: {_tail(ended.said)}"
            self.bar.write(said, file=self.out)
        elif ended and self.bar.disable:
            count = f"{len(progress.done)} of {len(progress.tasks)}"
            logger.info("%s: %s in %.0f s (%s)", count, ended.name, ended.seconds, ended.where)
        running = ", ".join(name.rpartition(":")[2] for name in progress.running)
        left = progress.seconds_left(self.cores) / 60
        failed = f"; {len(progress.failed)} failed" if progress.failed else ""
        self.bar.n = len(progress.done)
        self.bar.set_postfix_str(f"about {left:.0f} min left{failed}: {running}")


def _tail(said: str) -> str:
    return "\n  ".join(said.splitlines()[-LINES:])


def _told(progress: Progress, pages: Sequence[Path]) -> int:
    """Say what became of all tasks; the exit code."""
    again = sum(progress.lost.values())
    retold = f", {again} begun again" if again else ""
    logger.info("%d of %d tasks done%s", len(progress.done), len(progress.tasks), retold)
    for name in progress.failed:
        logger.info("failed: %s", name)
    for name in sorted(progress.left):
        logger.info("left, since it needs one that failed: %s", name)
    for page in pages:
        logger.info("tables and charts: %s", page)
    return 1 if progress.failed else 0
