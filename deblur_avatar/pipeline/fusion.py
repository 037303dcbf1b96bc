"""Fusion, the last stage of fitting: sharp and averaged renders blended by where the body moved."""

import time
from typing import Annotated, Any, Literal

import torch
from pydantic import Field

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.config.section import Params
from deblur_avatar.motion.kinds import trajectory_from_artifact
from deblur_avatar.motion.trajectory import MotionParams
from deblur_avatar.training.fusion_network import FusionNetwork, FusionNetworkParams
from deblur_avatar.training.params import FitParams, RecipeParams
from deblur_avatar.training.resume import RunFolder
from deblur_avatar.training.schedule import ScheduleParams
from deblur_avatar.training.supervision import MaskName
from deblur_avatar.training.trainer import AvatarFit, Report


class UnfusedParams(Params):
    """One render is compared with the frame, as in the stage before."""

    supervision: Literal["sharp", "mean"]
    mask: MaskName


class FusedParams(Params):
    """A network blends the sharp and the averaged render."""

    supervision: Literal["fused", "released"]
    mask: MaskName
    network: FusionNetworkParams


# The last stage: what the frame is compared with from here on.
FusionParams = Annotated[UnfusedParams | FusedParams, Field(discriminator="supervision")]


def fuse(
    observations: Observations,
    avatar: Avatar,
    motion: Motion,
    checkpoint: Checkpoint,
    recipe: RecipeParams,
    motion_params: MotionParams,
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
    model = avatar_from_artifact(avatar, observations.body, device)
    trajectory = trajectory_from_artifact(motion)
    network = new_network(params, model, len(observations.frames))
    network = None if network is None else network.to(device)
    fitted = FitParams(
        recipe=recipe, motion=motion_params, schedule=schedule, fusion=network_params(params)
    )
    fit = AvatarFit(model, trajectory, observations, fitted, device, generator, network)
    fit.restore(checkpoint)
    seconds = fit.run(
        schedule.trajectory + 1, schedule.fusion, params.supervision, params.mask, report, folder
    )
    refined = trajectory.to_artifact(model.betas, observations.timestamps)
    begin = time.perf_counter()
    model.inpaint(recipe.fitting, observations, refined.centre, finished=True)
    cost = fit.cost(seconds + time.perf_counter() - begin)
    return model.to_artifact(schedule.fusion), refined, cost


def network_params(params: FusionParams) -> FusionNetworkParams | None:
    """Those of the network that blends renders, where they are blended."""
    return None if isinstance(params, UnfusedParams) else params.network


def new_network(params: FusionParams, model: AvatarModel, frames: int) -> FusionNetwork | None:
    """The network that blends renders, where they are blended."""
    sizes = network_params(params)
    if sizes is None:
        return None
    return FusionNetwork(
        model.pose_code_size if sizes.pose else 0, frames,
        sizes.frame_codes, sizes.color_features, sizes.hidden, sizes.precision,
    )  # fmt: skip
