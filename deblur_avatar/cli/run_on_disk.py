"""A run as it lies on disk, finished or on its way: the newest avatar, and how far fitting is.

Read from what the fitting stages write anyway (`training/resume.py`): a folder for each stage that
has ended, and beside it `.<item>.unfinished` while it runs, with a snapshot now and then and a save
of everything every 20 s. Nothing is written, and no lock is taken.

It may be a fit of another schedule than the parameters say now. Which one, nothing of it says in
words, but when its stages ended and which snapshots it kept does.
"""

import json
import logging
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.cli.homes import PARAMS
from deblur_avatar.cli.locked_stages import LOCK, locked_stage
from deblur_avatar.config.reading import load_params
from deblur_avatar.config.runs import RunParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.motion.frame import FixedMotion
from deblur_avatar.training.resume import Snapshot
from deblur_avatar.training.schedule import ScheduleParams

logger = logging.getLogger(__name__)

STAGES = ("warmup", "trajectory", "fusion")  # in their order
AGAIN = "run again what fits it (`deblur-avatar video`, `dvc repro`), to its end"


@dataclass(frozen=True)
class Kept:
    """An avatar that lies on disk."""

    place: Path
    stage: str
    iteration: int
    whole: bool  # a stage's own output, not a snapshot


@dataclass(frozen=True)
class Standing:
    """How far a run is."""

    iteration: int
    last: int | None  # iteration of the whole run; None: by no schedule that there is now
    seconds: float | None  # of fitting in the present stage, of all iterations that it has made

    @property
    def finished(self) -> bool:
        """Whether nothing more is to come."""
        return self.last is not None and self.iteration >= self.last


class RunOnDisk:
    """The folders of one run.

    Raises:
        ConfigError: if the parameters do not know it.
    """

    def __init__(self, folder: Path, name: str) -> None:
        file = folder / PARAMS
        self.name = name
        self.run: RunParams = load_params(file, f"runs.{name}", RunParams)
        self._folder, self._footage = folder, folder / load_params(file, "from.footage", str)
        chosen = load_params(file, "schedule", str)
        self.schedule: ScheduleParams = load_params(file, f"schedules.{chosen}", ScheduleParams)
        self._schedules = load_params(file, "schedules", dict[str, ScheduleParams])
        self._snapshots = load_params(file, "snapshots", int)
        run = self.run
        self.warmup = _item(run, name, "warmup")  # what it goes on from
        self._outs = {stage: folder / "data" / stage / _item(run, name, stage) for stage in STAGES}

    def observations(self) -> Observations:
        """What it is fitted to.

        Raises:
            ArtifactError: if that was not made yet.
        """
        run = self.run
        return Observations.load(self._footage / "preprocess" / run.scene / run.observations)

    def newest(self) -> Kept | None:
        """The newest avatar; None before the first snapshot."""
        return next(self._newest_first(), None)

    def newest_since_warmup(self) -> Kept | None:
        """The newest avatar that is no older than the warm-up's.

        Where the warm-up was just made again, what later stages left is of an earlier fit.
        """
        warmup = self._outs["warmup"]
        made = _touched(warmup)
        kept = (one for one in self._newest_first() if one.place.is_dir())
        return next((k for k in kept if k.place == warmup or _touched(k.place) >= made), None)

    def all_kept(self) -> list[Kept]:
        """All avatars on the way to the newest, in their order."""
        by_iteration = {kept.iteration: kept for kept in self._newest_first()}
        return [by_iteration[iteration] for iteration in sorted(by_iteration)]

    def fitted(self, kept: Kept, observations: Observations) -> FittedRun:
        """What can be shown of an avatar on its way.

        Raises:
            ArtifactError: if it is damaged, was thrown away in between, or saw other frames.
        """
        if not kept.whole:
            snapshot = Snapshot.load(kept.place)
            avatar, motion = snapshot.avatar, snapshot.motion
        else:
            avatar = Avatar.load(kept.place / "avatar")
            motion = self._motion(kept.place, avatar, observations)
        check_same_frames(self.name, motion, observations)
        if kept.whole:
            check_same_pictures(self._folder, self.name, kept.stage)
        last, far = self._last(kept, kept.stage), ""
        if last is None:
            far = f", step {kept.iteration}, of another schedule"
        elif kept.iteration < last:
            far = f", step {kept.iteration} of {last}"
        return FittedRun(f"{self.name}{far}", avatar, motion, observations)

    def standing(self) -> Standing:
        """How far it is, by the newest save or avatar."""
        kept = self.newest()
        iteration, seconds = (0 if kept is None else kept.iteration), None
        running = self._running()
        if running is not None:
            for save in self._saves(running)[-1:]:
                found = _number(save.name)
                if found >= iteration:
                    iteration, seconds = found, _in_manifest(save, "seconds")
        reached = running or (STAGES[0] if kept is None else kept.stage)
        return Standing(iteration, self._last(kept, reached), seconds)

    def seconds_left(self) -> float | None:
        """What is left of fitting at the present stage's pace; None where that is not known."""
        standing, stage = self.standing(), self._running()
        schedule = None if stage is None else self._made_with(stage)
        if stage is None or schedule is None or standing.seconds is None:
            return None
        begun = 0 if stage == "warmup" else getattr(schedule, STAGES[STAGES.index(stage) - 1])
        made = standing.iteration - begun
        return (
            None if made <= 0 else standing.seconds / made * (schedule.fusion - standing.iteration)
        )

    def _motion(self, place: Path, avatar: Avatar, observations: Observations) -> Motion:
        if (place / "motion").is_dir():
            return Motion.load(place / "motion")
        given = FixedMotion(observations.poses)  # the warm-up keeps them
        return given.to_artifact(avatar.betas, observations.timestamps)

    def _unfinished(self, stage: str) -> Path:
        out = self._outs[stage]
        return out.with_name(f".{out.name}.unfinished")

    def _running(self) -> str | None:
        """The stage that was at work last and has not ended.

        A fit of another schedule that was stopped is passed over, once DVC has brought back what
        the present one had made.
        """
        begun = {stage: _touched(self._unfinished(stage)) for stage in STAGES}
        going = [s for s in STAGES if begun[s] and begun[s] >= _touched(self._outs[s])]
        return max(going, key=lambda stage: begun[stage], default=None)

    def _last(self, kept: Kept | None, reached: str) -> int | None:
        """The last iteration of the fit that has come to a stage, and of which this is kept."""
        if kept is not None and kept.whole and kept.stage == reached == STAGES[-1]:
            return kept.iteration
        schedule = self._made_with(reached)
        return None if schedule is None else schedule.fusion

    def _made_with(self, reached: str) -> ScheduleParams | None:
        """The schedule of the fit that has come to a stage: the present one, unless it cannot be.

        None where none of those that there are can, or others that differ in their length.
        """
        if self._may_be_of(self.schedule, reached):
            return self.schedule
        others = [one for one in self._schedules.values() if self._may_be_of(one, reached)]
        return others[0] if len({one.fusion for one in others}) == 1 else None

    def _may_be_of(self, schedule: ScheduleParams, reached: str) -> bool:
        """Whether stages up to this one ended, and kept snapshots, at a schedule's iterations."""
        begun, running, wanted = 0, self._running(), schedule.halvings(self._snapshots)
        for stage in STAGES[: STAGES.index(reached) + 1]:
            end, made = getattr(schedule, stage), self._outs[stage] / "avatar"
            if stage == running:
                saved = [_number(save.name) for save in self._saves(stage)]
                kept = {_number(place.name) for place in _snapshots(self._unfinished(stage))}
                here = max([begun, *saved, *kept])
                asked = {iteration for iteration in wanted if begun < iteration <= here}
                if kept != asked or not all(begun <= one <= end for one in [*saved, *kept]):
                    return False
            elif made.is_dir() and _in_manifest(made, "iteration") != end:
                return False
            begun = end
        return True

    def _saves(self, stage: str) -> list[Path]:
        return sorted(self._unfinished(stage).glob("after_*"))

    def _newest_first(self) -> Iterator[Kept]:
        """While a stage runs, what later stages left is of an earlier fit."""
        running = self._running()
        stages = STAGES if running is None else STAGES[: STAGES.index(running) + 1]
        for stage in reversed(stages):
            out = self._unfinished(stage) if stage == running else self._outs[stage]
            if stage != running and (out / "avatar").is_dir():
                said = _in_manifest(out / "avatar", "iteration")
                ended = getattr(self.schedule, stage) if said is None else round(said)
                yield Kept(out, stage, ended, whole=True)
            for place in reversed(_snapshots(out)):
                yield Kept(place, stage, _number(place.name), whole=False)


def check_same_frames(name: str, motion: Motion, observations: Observations) -> None:
    """Refuse a run that was fitted before its frames were chosen or read anew.

    Args:
        name: of the run.
        motion: fitted, or on its way.
        observations: what `preprocess` made last.

    Raises:
        ArtifactError: if the two have frames of other times.
    """
    if not torch.equal(motion.timestamps, observations.timestamps):
        raise ArtifactError(
            f"{name} was fitted to {_frames(motion.timestamps)}, and its scene now has "
            f"{_frames(observations.timestamps)}; {AGAIN}"
        )


def check_same_pictures(folder: Path, name: str, stage: str) -> None:
    """Refuse a run that was fitted before its frames were made of another film, say.

    By what DVC's locks say of them, where they do. A schedule of another size makes other frames
    of the same film: whether it was the same is not known then.

    Args:
        folder: whose parameters name the run.
        name: of the run.
        stage: whose output is to be shown.

    Raises:
        ArtifactError: if what `preprocess` made last is not what the stage was given.
    """
    run: RunParams = load_params(folder / PARAMS, f"runs.{name}", RunParams)
    footage = load_params(folder / PARAMS, "from.footage", str)
    seen = f"preprocess/{run.scene}/{run.observations}"
    fitted = locked_stage(folder, f"{stage}@{_item(run, name, stage)}")
    prepared = locked_stage((folder / footage).parent, f"preprocess@{run.scene}")
    digests = {fitted.read(f"{footage}/{seen}"), prepared.left(f"data/{seen}")} - {None}
    if len(digests) > 1 and fitted.schedule == prepared.schedule:
        raise ArtifactError(
            f"{name} was fitted to other frames than its scene has now, as {folder / LOCK} says: "
            f"of another film, or with other masks or poses; {AGAIN}"
        )


def _item(run: RunParams, name: str, stage: str) -> str:
    """What a stage calls its part of a run, which runs that differ later may share."""
    return f"{run.scene}-{run.observations}-{run.avatar}" if stage == STAGES[0] else name


def _touched(folder: Path) -> int:
    """When something was made or removed in a folder last, in ns; 0 where there is none."""
    try:
        return folder.stat().st_mtime_ns
    except FileNotFoundError:
        return 0


def _frames(timestamps: Float[Tensor, " F"]) -> str:
    return f"{len(timestamps)} frames from {timestamps[0]:.3f} to {timestamps[-1]:.3f} s"


def _number(name: str) -> int:
    return int(re.sub(r"\D", "", name))


def _snapshots(folder: Path) -> list[Path]:
    return sorted((folder / "snapshots").glob("[0-9]*"))


def _in_manifest(place: Path, key: str) -> float | None:
    """A number of an artifact that may be thrown away at any moment, if it is one."""
    try:
        found = float(json.loads((place / "manifest.json").read_text())[key])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return found if math.isfinite(found) else None
