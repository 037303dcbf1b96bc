"""The first stage of fitting: an avatar without a model of blur."""

import time
from typing import Any

import torch

from deblur_avatar.artifacts import Avatar, Checkpoint, Observations
from deblur_avatar.avatar.model import AvatarModel
from deblur_avatar.avatar.motion import FrameMotion
from deblur_avatar.config import ScheduleParams, StartParams
from deblur_avatar.fitting.avatar_fit import AvatarFit, Report
from deblur_avatar.fitting.run_folder import RunFolder


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
    trajectory = FrameMotion(observations.poses, refined=False).to(device)
    fit = AvatarFit(model, trajectory, observations, params, schedule, device, generator)
    begun = folder is not None and folder.progress is not None
    if params.model.skinning is not None and not begun:
        fit.pretrain_skinning(params.model.skinning.pretrain)
    spent = time.perf_counter() - begin
    seconds = fit.run(1, schedule.warmup, "sharp", "mean", report, folder, spent)
    cost = fit.cost(seconds)
    return model.to_artifact(schedule.warmup), fit.checkpoint(schedule.warmup), cost
