"""Animation: an avatar in motions that it was not filmed in."""

import logging
from typing import Annotated

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from pydantic import Field
from torch import Tensor

from deblur_avatar.animation.captured_motion import captured_motion
from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.animation.motion_files import read_motion
from deblur_avatar.animation.showing import Progress, plan_shot, render_shot
from deblur_avatar.animation.stage import stage_of_clip
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.config.reading import expand_environment
from deblur_avatar.config.section import (
    Fraction,
    NonNegative,
    Params,
    Positive,
)
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.imaging.contact_sheets import contact_sheet


class AnimationParams(Params):
    """A motion that the avatar of the run of this name is shown in.

    `motion` is `own` (the one that was filmed), `builtin:<name>` or a file, and may hold
    `$(VARIABLE:-default)`.
    """

    scene: str
    motion: str
    start: NonNegative  # seconds into the motion
    seconds: Positive
    fps: Positive
    image_size: Annotated[int, Field(ge=16, multiple_of=2)]  # square, pixels; videos want it even
    turns: float  # of the stage from the first frame to the last, so that every side is seen
    travel: Fraction  # of the motion's steps; 0 is on the spot
    margin: NonNegative  # around the person, as a share of the picture she fills
    # sRGB grey behind her: black hair, and what stands off black clothes, cannot be seen on black.
    backdrop: Fraction


logger = logging.getLogger(__name__)

OWN = "own"  # the motion that was filmed
SHEET_FRAMES, SHEET_COLUMNS, SHEET_SIDE = 12, 6, 256  # pictures, pictures a row, pixels of each


def animate(
    avatar: Avatar,
    observations: Observations,
    fitted: Motion,
    params: AnimationParams,
    *,
    where: str,
    device: torch.device,
    progress: Progress,
) -> UInt8[Tensor, "F H W 3"]:
    """Render an avatar doing a motion, seen from where its training camera stood.

    The person keeps its shape, stands where it was filmed and faces the camera at first.

    Args:
        avatar: the one to render.
        observations: how the person was filmed; gives body, camera and the way up.
        fitted: the motion it was filmed in, shown if `params.motion` is `own`.
        params: which motion, and how to show it.
        where: key of `params`, for messages.
        device: on which to render.
        progress: wraps the loop over frames.

    Raises:
        ConfigError: if there is no such motion, or it cannot be shown from this camera.
        ArtifactError: if the motion's file is damaged.
    """
    camera = observations.camera
    motion = _driven(observations.body, avatar, params, where)
    try:
        stage = stage_of_clip(observations, avatar.betas)
        if motion is None:
            motion = captured_motion(fitted, stage, params.fps, params.start, params.seconds)
        shot = plan_shot(
            motion, observations.body, avatar.betas, stage, camera.K, camera.viewmat,
            size=params.image_size, margin=params.margin, turns=params.turns, travel=params.travel,
        )  # fmt: skip
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from None
    logger.info("%d frames of %s at %g a second", len(shot.poses.transl), params.motion, params.fps)
    model = avatar_from_artifact(avatar, observations.body, device)
    return render_shot(model, shot, progress, params.backdrop)


def _driven(body: Body, avatar: Avatar, params: AnimationParams, where: str) -> BodyMotion | None:
    """The motion that is named; None for the one that was filmed."""
    if params.motion == OWN:
        return None
    return read_motion(
        expand_environment(params.motion, f"{where}.motion"),
        body,
        avatar.betas,
        fps=params.fps,
        start=params.start,
        seconds=params.seconds,
    )


def sheet_of(frames: UInt8[Tensor, "F H W 3"], fps: float) -> UInt8[np.ndarray, "_ _ 3"]:
    """Some frames from the first to the last in one picture, each with its time."""
    chosen = evenly_spaced(range(len(frames)), SHEET_FRAMES)
    side = min(SHEET_SIDE, frames.shape[1])
    pictures = [
        cv2.resize(frames[i].numpy(), (side, side), None, 0, 0, cv2.INTER_AREA) for i in chosen
    ]
    return contact_sheet(pictures, SHEET_COLUMNS, [f"{index / fps:.2f} s" for index in chosen])
