"""Fusion, the last stage of fitting: sharp and averaged renders blended by where the body moved."""

from typing import Annotated, Any, Literal

import torch
from pydantic import Field

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.model import AvatarModel
from deblur_avatar.config.section import Params
from deblur_avatar.motion.kinds import trajectory_from_artifact
from deblur_avatar.training.fusion_network import FusionNetwork, FusionNetworkParams
from deblur_avatar.training.params import StartParams
from deblur_avatar.training.resume import RunFolder
from deblur_avatar.training.schedule import ScheduleParams
from deblur_avatar.training.supervision import Mask
from deblur_avatar.training.trainer import AvatarFit, Report


class UnfusedParams(Params):
    """One render is compared with the frame, as in the stage before."""

    supervision: Literal["sharp", "mean"]
    mask: Mask


class FusedParams(Params):
    """A network blends the sharp and the averaged render."""

    supervision: Literal["fused", "released"]
    mask: Mask
    network: FusionNetworkParams


# The last stage: what the frame is compared with from here on.
FusionParams = Annotated[UnfusedParams | FusedParams, Field(discriminator="supervision")]


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
    """
    model = AvatarModel.from_artifact(avatar, observations.body, device)
    trajectory = trajectory_from_artifact(motion).to(device)
    network = new_network(params, start, model, len(observations.frames))
    network = None if network is None else network.to(device)
    fit = AvatarFit(model, trajectory, observations, start, schedule, device, generator, network)
    fit.restore(checkpoint)
    seconds = fit.run(
        schedule.trajectory + 1, schedule.fusion, params.supervision, params.mask, report, folder
    )
    refined = trajectory.to_artifact(model.betas, observations.timestamps)
    cost = fit.cost(seconds)
    return model.to_artifact(schedule.fusion), refined, cost


def new_network(
    params: FusionParams, start: StartParams, model: AvatarModel, frames: int
) -> FusionNetwork | None:
    """The network that blends renders, where they are blended."""
    if isinstance(params, UnfusedParams):
        return None
    sizes = params.network
    posed = sizes.pose and start.model.nonrigid is not None
    return FusionNetwork(
        model.pose_encoder.size if posed else 0, frames,
        sizes.frame_codes, sizes.color_features, sizes.hidden, sizes.precision,
    )  # fmt: skip
