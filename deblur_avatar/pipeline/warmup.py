"""Warm-up, the first stage of fitting: an avatar without a model of blur."""

import time
from typing import Any

import torch

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.model import AvatarModel
from deblur_avatar.motion.frame import FixedMotion
from deblur_avatar.training.params import StartParams
from deblur_avatar.training.resume import RunFolder
from deblur_avatar.training.schedule import ScheduleParams
from deblur_avatar.training.trainer import AvatarFit, Report


def warm_up(
    observations: Observations,
    params: StartParams,
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
        The avatar, its optimisers' memory, and what it cost.
    """
    begin = time.perf_counter()
    betas = observations.poses.betas.to(device)
    model = AvatarModel.create(
        params.model, observations.body, betas, len(observations.frames), schedule.gaussians,
        observations.light, generator,
    ).to(device)  # fmt: skip
    trajectory = FixedMotion(observations.poses).to(device)
    fit = AvatarFit(model, trajectory, observations, params, schedule, device, generator)
    begun = folder is not None and folder.progress is not None
    if params.model.skinning is not None and not begun:
        fit.pretrain_skinning(params.model.skinning.pretrain)
    spent = time.perf_counter() - begin
    seconds = fit.run(1, schedule.warmup, "sharp", "mean", report, folder, spent)
    cost = fit.cost(seconds)
    return model.to_artifact(schedule.warmup), fit.checkpoint(schedule.warmup), cost
