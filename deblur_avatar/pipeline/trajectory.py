"""The second stage of fitting: motion inside each exposure joins the unknowns."""

from collections.abc import Mapping
from typing import Any

import torch

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.model import AvatarModel
from deblur_avatar.errors import ConfigError
from deblur_avatar.motion.clip import ClipMotion
from deblur_avatar.motion.exposure_motions import EXPOSURE_MOTIONS
from deblur_avatar.motion.knot_spacing import choose_spacing
from deblur_avatar.motion.params import TrajectoryParams
from deblur_avatar.motion.trajectory import (
    FrameMotion,
    Trajectory,
    instants,
)
from deblur_avatar.training.params import StartParams
from deblur_avatar.training.resume import RunFolder
from deblur_avatar.training.schedule import ScheduleParams
from deblur_avatar.training.shutter_certainty import settle_shutter
from deblur_avatar.training.trainer import AvatarFit, Report
from deblur_avatar.training.virtual_poses import choose_counts


def fit_trajectory(
    observations: Observations,
    avatar: Avatar,
    checkpoint: Checkpoint,
    start: StartParams,
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
        The avatar, its motion, its optimisers' memory, and what it cost; with the shutter where
        that is estimated.
    """
    model = AvatarModel.from_artifact(avatar, observations.body, device)
    trajectory = new_trajectory(observations, params, generator).to(device)
    choose_counts(trajectory, observations, params)
    fit = AvatarFit(model, trajectory, observations, start, schedule, device, generator)
    fit.restore(checkpoint)
    half = (schedule.warmup + schedule.trajectory) // 2

    def watch(iteration: int, terms: Mapping[str, float]) -> None:
        if iteration == half and isinstance(trajectory, ClipMotion):
            trajectory.mark_halfway()
        report(iteration, terms)

    seconds = fit.run(
        schedule.warmup + 1, schedule.trajectory, params.supervision, params.mask, watch, folder
    )
    shutter: dict[str, Any] = {}
    if isinstance(trajectory, ClipMotion) and trajectory.halfway is not None:
        shutter = settle_shutter(model, trajectory, observations)
    choose_counts(trajectory, observations, params)
    motion = trajectory.to_artifact(model.betas, observations.timestamps)
    cost = fit.cost(seconds) | shutter
    last = schedule.trajectory
    return model.to_artifact(last), motion, fit.checkpoint(last), cost


def new_trajectory(
    observations: Observations, params: TrajectoryParams, generator: torch.Generator
) -> Trajectory:
    """The unknown motion, as far as it is known before fitting.

    Raises:
        ConfigError: if one trajectory for the clip is asked for, and its exposure is unknown or it
            has a single frame.
    """
    poses = observations.poses
    if params.motion in EXPOSURE_MOTIONS:
        u = instants(params.virtual_poses, params.quadrature)
        return EXPOSURE_MOTIONS[params.motion](poses, u, params.start_noise, generator)
    if params.motion == "clip":
        if observations.exposure is None:
            raise ConfigError(
                "motion: clip needs to know how long the shutter was open; the clip does not say"
            )
        if len(observations.timestamps) < 2:
            raise ConfigError(
                "motion: clip needs two frames or more, the clip has 1: a single blurred frame "
                "does not tell which way it moved; take more frames, or a method with motion: pair"
            )
        frame = float(observations.timestamps.diff().median())
        u = instants(params.virtual_poses, params.quadrature)
        coarsest, finest = params.knot_frames * frame, params.finest_knot_frames * frame
        spacing = choose_spacing(
            poses, observations.timestamps, coarsest, finest, params.smoothness
        )
        return ClipMotion.near(
            poses, u, observations.timestamps, observations.exposure, spacing, params.smoothness,
            estimate_shutter=params.shutter == "estimated",
        )  # fmt: skip
    return FrameMotion(poses, refined=params.motion == "frame")
