"""Warm-up, the first stage of fitting: an avatar without a model of blur."""

import time
from typing import Any

import torch

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.kinds import AVATARS
from deblur_avatar.motion.frame import FixedMotion, FixedParams
from deblur_avatar.training.params import FitParams, RecipeParams
from deblur_avatar.training.resume import RunFolder
from deblur_avatar.training.schedule import ScheduleParams
from deblur_avatar.training.trainer import AvatarFit, Report


def warm_up(
    observations: Observations,
    recipe: RecipeParams,
    schedule: ScheduleParams,
    *,
    device: torch.device,
    generator: torch.Generator,
    report: Report,
    folder: RunFolder | None = None,
) -> tuple[Avatar, Checkpoint, dict[str, Any]]:
    """Fit sharp renders at the given poses to the frames, whatever blur they hold.

    With a `folder` it goes on where an earlier run of the same was stopped.

    Returns:
        The avatar, its optimizers' memory, and what it cost.
    """
    begin = time.perf_counter()
    betas = observations.poses.betas.to(device)
    avatar = AVATARS[recipe.model.kind].create(
        recipe.model, observations.body, betas, len(observations.frames),
        schedule.gaussians_of(schedule.level_at(1)), observations.averaging_space, generator,
    ).to(device)  # fmt: skip
    trajectory = FixedMotion(observations.poses)
    params = FitParams(recipe=recipe, motion=FixedParams(kind="fixed"), schedule=schedule)
    fit = AvatarFit(avatar, trajectory, observations, params, device, generator)
    resumes = folder is not None and folder.progress is not None
    if not resumes:
        avatar.pretrain(generator)
    spent = time.perf_counter() - begin
    seconds = fit.run(1, schedule.warmup, "sharp", "mean", report, folder, spent)
    begin = time.perf_counter()
    avatar.inpaint(recipe.fitting, observations, observations.poses, finished=False)
    cost = fit.cost(seconds + time.perf_counter() - begin)
    return avatar.to_artifact(schedule.warmup), fit.checkpoint(schedule.warmup), cost
