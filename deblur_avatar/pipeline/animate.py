"""An avatar in motions that it was not filmed in."""

import dataclasses
import logging
from collections.abc import Callable, Iterable
from typing import Annotated

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from pydantic import Field
from torch import Tensor

from deblur_avatar.animation.captured_motion import own_motion
from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.animation.motion_files import read_motion
from deblur_avatar.animation.placement import (
    framed_intrinsics,
    level_view,
    place,
)
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.model import AvatarModel, render_avatar
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.config.reading import expand_environment
from deblur_avatar.config.section import (
    Fraction,
    NonNegative,
    Params,
    Positive,
)
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.cameras import Camera
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


logger = logging.getLogger(__name__)

OWN = "own"  # the motion that was filmed
SHEET_FRAMES, SHEET_COLUMNS, SHEET_SIDE = 12, 6, 256  # pictures, pictures a row, pixels of each
FRAMING_POSES = 32  # poses looked at to find the frame that holds the person throughout


def animate(
    avatar: Avatar,
    observations: Observations,
    fitted: Motion,
    params: AnimationParams,
    *,
    where: str,
    device: torch.device,
    progress: Callable[[Iterable[int], str], Iterable[int]],
) -> UInt8[Tensor, "F H W 3"]:
    """Draw an avatar doing a motion, seen from where its training camera stood.

    The person keeps its shape, stands where it was filmed and faces the camera at first.

    Args:
        avatar: whom to draw.
        observations: how the person was filmed; gives body, camera and the way up.
        fitted: the motion it was filmed in, shown if `params.motion` is `own`.
        params: which motion, and how to show it.
        where: key of `params`, for messages.
        device: on which to draw.
        progress: wraps the loop over frames.

    Raises:
        ConfigError: if there is no such motion, or it cannot be shown from this camera.
        ArtifactError: if the motion's file is damaged.
    """
    body, cameras = observations.body, observations.cameras
    filmed = dataclasses.replace(observations.poses, betas=avatar.betas)
    motion = _motion(fitted, observations, avatar, params, where)
    try:
        # Only where the camera stands decides what it sees; real ones often hang askew.
        viewmat = level_view(body, filmed, cameras.viewmats[observations.train_camera])
        poses = place(motion, body, filmed, viewmat, turns=params.turns, travel=params.travel)
        points = _surfaces(body, poses)
        K = framed_intrinsics(
            points, cameras.Ks[observations.train_camera], viewmat, params.image_size, params.margin
        )
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from None
    logger.info("%d frames of %s at %g a second", len(poses.transl), params.motion, params.fps)
    model = AvatarModel.from_artifact(avatar, body, device)
    camera = Camera(K, viewmat, params.image_size, params.image_size)
    frames = []
    for index in progress(range(len(poses.transl)), "animate"):
        image, _ = render_avatar(model, poses.at([index]), camera)
        frames.append((image[0].cpu() * 255).round().to(torch.uint8))
    return torch.stack(frames)


def _motion(
    fitted: Motion, observations: Observations, avatar: Avatar, params: AnimationParams, where: str
) -> BodyMotion:
    body = observations.body
    if params.motion == OWN:
        viewmat = observations.cameras.viewmats[observations.train_camera]
        try:
            return own_motion(fitted, body, viewmat, params.fps, params.start, params.seconds)
        except ValueError as error:
            raise ConfigError(f"{where}: {error}") from None
    return read_motion(
        expand_environment(params.motion, f"{where}.motion"),
        body,
        avatar.betas,
        fps=params.fps,
        start=params.start,
        seconds=params.seconds,
    )


def _surfaces(body: Body, poses: Poses) -> Float[Tensor, "F P 3"]:
    """Vertices in a few of the poses; one by one, to bound the memory that blend weights take."""
    step = -(-len(poses.transl) // FRAMING_POSES)
    few = [poses.at([index]) for index in range(0, len(poses.transl), step)]
    return torch.cat([posed(body, poses).vertices for poses in few])


def sheet_of(frames: UInt8[Tensor, "F H W 3"], fps: float) -> UInt8[np.ndarray, "_ _ 3"]:
    """Some frames from the first to the last in one picture, each with its time."""
    count = min(SHEET_FRAMES, len(frames))
    chosen = np.linspace(0, len(frames) - 1, count).round().astype(int)
    side = min(SHEET_SIDE, frames.shape[1])
    pictures = [
        cv2.resize(frames[i].numpy(), (side, side), None, 0, 0, cv2.INTER_AREA) for i in chosen
    ]
    return contact_sheet(pictures, SHEET_COLUMNS, [f"{index / fps:.2f} s" for index in chosen])
