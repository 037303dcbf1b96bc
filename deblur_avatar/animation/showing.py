"""Rendered animation: an avatar in a motion, placed and seen by one camera.

Conventions. Pictures are square, `size` pixels; the camera stays where it is, looks at the person
upright, and is cropped so that the whole motion fits.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.animation.placement import framed_camera, level_view, place
from deblur_avatar.animation.stage import Stage
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.imaging.exposure import decode

FRAMING_POSES = 32  # poses looked at to find the frame that holds the person throughout

Progress = Callable[[Iterable[int], str], Iterable[int]]


@dataclass(frozen=True)
class Shot:
    """Poses in the world, and the camera that holds all of them."""

    poses: Poses
    camera: Camera


def plan_shot(
    motion: BodyMotion,
    body: Body,
    betas: Float[Tensor, " B"],
    stage: Stage,
    K: Float[Tensor, "3 3"],
    viewmat: Float[Tensor, "4 4"],
    *,
    size: int,
    margin: float,
    turns: float,
    travel: float,
) -> Shot:
    """Let the filmed person do a motion where it was filmed, and point the camera.

    Args:
        motion: what to do.
        body: the filmed person's.
        betas: her shape.
        stage: where she was filmed.
        K: of the camera that filmed it; only its crop and scale change.
        viewmat: of that camera; only the place counts, real ones often hang askew.
        size: of the pictures, pixels.
        margin: around the person, as a share of the picture.
        turns: how often the stage turns, so that every side is seen.
        travel: share of the motion's horizontal path that is kept.

    Raises:
        ValueError: if the motion cannot be shown from this camera.
    """
    poses = place(motion, body, betas, stage, turns=turns, travel=travel)
    level = level_view(stage, viewmat)
    points = _surfaces(body, poses)
    return Shot(poses, framed_camera(points, K, level, size, margin))


def render_shot(
    model: AvatarModel, shot: Shot, progress: Progress, backdrop: float = 0.0
) -> UInt8[Tensor, "F H W 3"]:
    """Render every pose of a shot, one after the other.

    Args:
        model: the avatar.
        shot: its poses, and the camera.
        progress: wraps the loop over frames.
        backdrop: grey behind the person, sRGB in [0, 1].
    """
    light = decode(torch.full((3,), backdrop), model.averaging_space).to(model.betas)
    frames = []
    for index in progress(range(len(shot.poses.transl)), "animate"):
        image, _ = render_avatar(model, shot.poses.at([index]), shot.camera, background=light)
        frames.append((image[0].cpu() * 255).round().to(torch.uint8))
    return torch.stack(frames)


def _surfaces(body: Body, poses: Poses) -> Float[Tensor, "F P 3"]:
    """Vertices in a few of the poses; one by one, to bound the memory that blend weights take."""
    step = -(-len(poses.transl) // FRAMING_POSES)
    few = [poses.at([index]) for index in range(0, len(poses.transl), step)]
    return torch.cat([posed(body, poses).vertices for poses in few])
