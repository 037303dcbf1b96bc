"""The last stage of fitting: sharp and averaged renders are blended where the body moved."""

from typing import Any

import torch

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.model import AvatarModel
from deblur_avatar.errors import ConfigError
from deblur_avatar.motion.saved_motion import trajectory_from_artifact
from deblur_avatar.training.fusion_network import FusionNetwork
from deblur_avatar.training.params import FusionParams, StartParams
from deblur_avatar.training.resume import RunFolder
from deblur_avatar.training.schedule import ScheduleParams
from deblur_avatar.training.trainer import AvatarFit, Report


def fuse(
    observations: Observations,
    avatar: Avatar,
    motion: Motion,
    checkpoint: Checkpoint,
    start: StartParams,
    params: FusionParams,
    schedule: ScheduleParams,
    *,
    device: torch.device,
    generator: torch.Generator,
    report: Report,
    folder: RunFolder | None = None,
) -> tuple[Avatar, Motion, dict[str, Any]]:
    """Finish the avatar and its motion.

    Returns:
        The avatar, its motion, and what it cost.

    Raises:
        ConfigError: if fusion is asked for without its network.
    """
    model = AvatarModel.from_artifact(avatar, observations.body, device)
    trajectory = trajectory_from_artifact(motion).to(device)
    network = None
    if params.supervision in ("fused", "released"):
        if params.network is None:
            raise ConfigError(
                f"fusion.supervision is {params.supervision}, which needs fusion.network"
            )
        posed = params.network.pose and start.model.nonrigid is not None
        network = FusionNetwork(
            model.pose_encoder.size if posed else 0, len(observations.frames),
            params.network.frame_codes, params.network.color_features, params.network.hidden,
        ).to(device)  # fmt: skip
    fit = AvatarFit(model, trajectory, observations, start, schedule, device, generator, network)
    fit.restore(checkpoint)
    seconds = fit.run(
        schedule.trajectory + 1, schedule.fusion, params.supervision, params.mask, report, folder
    )
    refined = trajectory.to_artifact(model.betas, observations.timestamps)
    cost = fit.cost(seconds)
    return model.to_artifact(schedule.fusion), refined, cost
