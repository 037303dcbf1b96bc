"""Shown motion: what an exported avatar does, in the world that the person was filmed in.

Conventions. Times are seconds from the motion's first frame, in order, not always evenly spaced.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.animation.motion_files import BUILTIN, read_motion
from deblur_avatar.animation.placement import place
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.config.section import Params, Positive
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun

OWN = "own"  # the motion that was filmed
MOST_FRAMES = 100_000  # an hour at 27 a second; 36 MB of poses


class MotionExport(Params):
    """Which motions an export holds."""

    motions: tuple[str, ...]  # own, builtin:<name> or files
    fps: Positive  # of motions that were not filmed
    seconds: Positive  # longest duration of these


@dataclass(frozen=True)
class ShownMotion:
    """Poses over time."""

    name: str  # that a link can hold
    label: str  # that a person reads
    times: Float[Tensor, " F"]
    poses: Poses


def shown_motions(
    run: FittedRun, names: Sequence[str], fps: float, seconds: float
) -> list[ShownMotion]:
    """The motions of these names, in their order.

    Args:
        run: whose avatar is to move.
        names: `own`, `builtin:<name>` or files (`animation/motion_files.py`).
        fps: frames a second of what was not filmed.
        seconds: longest duration of what was not filmed.

    Raises:
        ConfigError: if there is no such motion, two would have one name, there would be too many
            frames, or the person cannot be placed.
        ArtifactError: if a file is damaged.
    """
    if not names or len(set(names)) != len(names):
        raise ConfigError(f"export: motions must be named, each once, got {list(names)}")
    called: dict[str, str] = {}
    for name in names:
        other = called.setdefault(_called(name), name)
        if other != name:
            raise ConfigError(
                f"export: {other} and {name} would both be called {_called(name)!r}, and the first "
                "be lost; rename one file"
            )
    if fps * seconds > MOST_FRAMES:
        raise ConfigError(
            f"export: {seconds:g} seconds at {fps:g} frames a second are more than {MOST_FRAMES:,} "
            "frames; take fewer"
        )
    return [
        filmed_motion(run) if name == OWN else _driven(run, name, fps, seconds) for name in names
    ]


def filmed_motion(run: FittedRun) -> ShownMotion:
    """The fitted motion at the middle of every exposure."""
    times = run.motion.timestamps.double()
    poses = dataclasses.replace(run.motion.centre, betas=run.avatar.betas)
    return ShownMotion(OWN, "As filmed", (times - times[0]).float(), poses)


def _driven(run: FittedRun, name: str, fps: float, seconds: float) -> ShownMotion:
    body, betas = run.observations.body, run.avatar.betas
    motion = read_motion(name, body, betas, fps=fps, start=0.0, seconds=seconds)
    poses = place(motion, body, betas, run.stage, turns=0.0, travel=1.0)
    known = _called(name)
    label = known.replace("_", " ").capitalize()
    times = torch.arange(len(poses.transl)) / motion.fps
    return ShownMotion(known, label, times, poses)


def _called(name: str) -> str:
    """What a motion is called where it is shown, before it is read."""
    return name.removeprefix(BUILTIN) if name.startswith(BUILTIN) else Path(name).stem


def even_motion(run: FittedRun, name: str, fps: float, seconds: float) -> tuple[ShownMotion, float]:
    """One motion at an even rate, and that rate: its mean one, if it was filmed.

    Raises:
        ConfigError: as `shown_motions`, and if a filmed motion is one frame.
        ArtifactError: if the motion's file is damaged.
    """
    (motion,) = shown_motions(run, [name], fps, seconds)
    if name != OWN:
        return motion, fps
    times = motion.times.double()
    if len(times) < 2:
        raise ConfigError("export: a motion of one frame has no frame rate")
    rate = float((len(times) - 1) / times[-1])
    wanted = torch.arange(len(times)).double() / rate
    poses = motion.poses.at_times(times, wanted)
    return dataclasses.replace(motion, times=wanted.float(), poses=poses), rate
