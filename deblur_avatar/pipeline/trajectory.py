"""Trajectory, the second stage of fitting: motion inside each exposure joins the unknowns."""

from collections.abc import Mapping
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.render import as_filmed, render_avatar
from deblur_avatar.config.section import Params
from deblur_avatar.motion.kinds import KINDS, AnyMotionParams
from deblur_avatar.motion.trajectory import Instants, MotionParams, Render, Trajectory
from deblur_avatar.training.params import FitParams, RecipeParams
from deblur_avatar.training.resume import RunFolder
from deblur_avatar.training.schedule import ScheduleParams
from deblur_avatar.training.supervision import MaskName
from deblur_avatar.training.trainer import AvatarFit, Report


class TrajectoryParams(Params):
    """How the body moves while the shutter is open, and what the frame is compared with."""

    motion: AnyMotionParams
    supervision: Literal["sharp", "mean", "released"]
    mask: MaskName


def fit_trajectory(
    observations: Observations,
    avatar: Avatar,
    checkpoint: Checkpoint,
    recipe: RecipeParams,
    params: TrajectoryParams,
    schedule: ScheduleParams,
    *,
    device: torch.device,
    generator: torch.Generator,
    report: Report,
    folder: RunFolder | None = None,
) -> tuple[Avatar, Motion, Checkpoint, dict[str, Any]]:
    """Fit renders averaged over the exposure (or sharp ones, by `params`) to the frames.

    Returns:
        The avatar, its motion, its optimizers' memory, and what it cost; with what the trajectory
        says of itself, as of an estimated shutter.

    Raises:
        ConfigError: if the clip lacks what this kind of trajectory needs to know.
    """
    model = avatar_from_artifact(avatar, observations.body, device)
    trajectory = new_trajectory(observations, params.motion, generator)
    trajectory.choose_samples(observations)
    fitted = FitParams(recipe=recipe, motion=params.motion, schedule=schedule)
    fit = AvatarFit(model, trajectory, observations, fitted, device, generator)
    fit.restore(checkpoint)
    half = (schedule.warmup + schedule.trajectory) // 2

    def watch(iteration: int, terms: Mapping[str, float]) -> None:
        if iteration == half:
            trajectory.remember_halfway()
        report(iteration, terms)

    seconds = fit.run(
        schedule.warmup + 1, schedule.trajectory, params.supervision, params.mask, watch, folder
    )
    settled = trajectory.settle(observations, exposure_renderer(model, observations))
    trajectory.choose_samples(observations)
    motion = trajectory.to_artifact(model.betas, observations.timestamps)
    cost = fit.cost(seconds) | settled
    last = schedule.trajectory
    return model.to_artifact(last), motion, fit.checkpoint(last), cost


def new_trajectory(
    observations: Observations, params: MotionParams, generator: torch.Generator
) -> Trajectory:
    """The unknown motion, as far as it is known before fitting.

    Raises:
        ConfigError: if the clip lacks what this kind of trajectory needs to know.
    """
    return KINDS[params.kind].create(observations, params, generator)


def exposure_renderer(model: AvatarModel, observations: Observations) -> Render:
    """Render an avatar's average over some instants of a frame, as the training camera sees it."""

    def render(frame: int, instants: Instants) -> Float[Tensor, "H W 3"]:
        image, alpha = render_avatar(
            model,
            instants.poses(model.betas.detach()),
            observations.camera,
            frame=frame,
            average=True,
        )
        return as_filmed(observations, frame, image[0].cpu(), alpha[0].cpu())

    return render
