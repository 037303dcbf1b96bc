"""One fit of the suite: warm-up, trajectory and fusion in memory, with nothing saved."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.parameters import MethodParams
from deblur_avatar.pipeline.fusion import fuse
from deblur_avatar.pipeline.trajectory import fit_trajectory
from deblur_avatar.pipeline.warmup import warm_up
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.schedule import ScheduleParams

DEGENERATE_SCALE = 1e-12  # metres


@dataclass(frozen=True)
class Fitted:
    """What a fit leaves: avatar and motion, the estimated shutter, and the time it took."""

    avatar: Avatar
    motion: Motion
    shutter: float | None  # seconds; None where it was given
    shutter_std: float | None  # seconds
    seconds: float


@dataclass(frozen=True)
class FitSetup:
    """What all fits of one method share.

    `recipe` is what the avatar is made of, `method` what follows the warm-up; `validation_stride`
    is as `preprocess` wants it; damage and fits draw from `seed`, alike for every method.
    """

    recipe: RecipeParams
    method: MethodParams
    schedule: ScheduleParams
    validation_stride: int
    seed: int
    device: torch.device

    @classmethod
    def of(cls, method: str, params_file: Path, seed: int, device: torch.device) -> "FitSetup":
        """Read the setup of one method of the suite."""
        return cls(
            load_params(params_file, "avatars.lean", RecipeParams),
            load_params(params_file, f"methods.{method}", MethodParams),
            load_params(params_file, "schedules.suite", ScheduleParams),
            load_params(params_file, "validation_stride", int),
            seed,
            device,
        )


def fit_method(
    observations: Observations, setup: FitSetup, *, draw: int = 0, degenerate: float = 0.0
) -> Fitted:
    """Fit as the three stages do; every fit of the suite draws alike, so that they compare.

    Args:
        observations: blurred, or sharp with exact poses.
        setup: how and where.
        draw: number of the fit, of several that differ in their draws only.
        degenerate: share of the Gaussians that become extremely thin after the warm-up, and as
            many that become points.

    Raises:
        ConfigError, ArtifactError: as the stages do.
    """
    recipe, method, schedule, device = setup.recipe, setup.method, setup.schedule, setup.device
    drawn = run.derive_seed(setup.seed + draw, "stability")
    torch.manual_seed(drawn)  # third parties draw from it
    generator = torch.Generator(device=device).manual_seed(drawn)
    begin = time.perf_counter()
    avatar, checkpoint, _ = warm_up(
        observations, recipe, schedule, device=device, generator=generator, report=_silence
    )
    if degenerate > 0:
        avatar = _with_degenerate_gaussians(avatar, degenerate)
    avatar, motion, checkpoint, cost = fit_trajectory(
        observations, avatar, checkpoint, recipe, method.trajectory, schedule,
        device=device, generator=generator, report=_silence,
    )  # fmt: skip
    shutter, std = motion.shutter, cost.get("shutter_std_s")
    avatar, motion, _ = fuse(
        observations, avatar, motion, checkpoint, recipe, method.trajectory.motion,
        method.fusion, schedule, device=device, generator=generator, report=_silence,
    )  # fmt: skip
    return Fitted(avatar, motion, shutter, std, time.perf_counter() - begin)


def lengthened(schedule: ScheduleParams, times: float) -> ScheduleParams:
    """The same schedule with so many times its iterations."""
    ends = {
        name: round(times * getattr(schedule, name)) for name in ("warmup", "trajectory", "fusion")
    }
    return schedule.model_copy(update=ends)


def _with_degenerate_gaussians(avatar: Avatar, share: float) -> Avatar:
    log_scales = avatar.log_scales.clone()
    count = round(share * len(log_scales))
    log_scales[:count, 0] = math.log(DEGENERATE_SCALE)
    log_scales[count : 2 * count] = math.log(DEGENERATE_SCALE)
    return replace(avatar, log_scales=log_scales)


def _silence(iteration: int, losses: Mapping[str, float]) -> None:
    pass
