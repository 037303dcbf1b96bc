"""Placement: a moving body on the stage, upright in front of the camera that filmed the person."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.animation.stage import Stage
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.geometry.cameras import (
    Camera,
    camera_centres,
    crop_intrinsics,
    look_at,
    project,
)
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

NEAREST = 0.3  # metres; a camera nearer than that to a limb shows little else
REACH = 1.5  # metres that a camera may step back: limbs reach one from the pelvis


def place(
    motion: BodyMotion,
    body: Body,
    betas: Float[Tensor, " B"],
    stage: Stage,
    *,
    turns: float,
    travel: float,
) -> Poses:
    """Let the filmed person do the motion where it was filmed, facing the camera at the start.

    The first frame's heading is taken out, its lean against the vertical stays.

    Args:
        motion: what to do.
        body: the filmed person's.
        betas: her shape.
        stage: where she was filmed.
        turns: how often the stage turns from the first frame to the last, as if the camera went
            round, so that every side is seen.
        travel: share of the motion's horizontal path that is kept, 0 for motion on the spot.
    """
    orientation = axis_angle_to_matrix(motion.global_orient)
    heading = -_heading(orientation[0])
    share = torch.linspace(0, 1, len(orientation)) if len(orientation) > 1 else torch.zeros(1)
    turned = stage.world_from_stage @ about_y(heading + 2 * math.pi * turns * share)
    path = motion.transl - motion.transl.median(dim=0).values
    path = path * path.new_tensor([travel, 1.0, travel])
    path = (turned @ path[..., None])[..., 0]
    return Poses(
        betas=betas,
        global_orient=matrix_to_axis_angle(turned @ orientation),
        body_pose=motion.body_pose,
        transl=stage.anchor + path - shaped_joints(body, betas)[0],
    )


def level_view(stage: Stage, viewmat: Float[Tensor, "4 4"]) -> Float[Tensor, "4 4"]:
    """Turn a camera, where it stands, towards the person and upright."""
    return look_at(camera_centres(viewmat), stage.anchor, stage.up)


def about_y(angles: Float[Tensor, " F"]) -> Float[Tensor, "F 3 3"]:
    """Rotations about the vertical."""
    still = torch.zeros_like(angles)
    return axis_angle_to_matrix(torch.stack([still, angles, still], dim=-1))


def framed_camera(
    points: Float[Tensor, "*batch P 3"],
    K: Float[Tensor, "3 3"],
    viewmat: Float[Tensor, "4 4"],
    size: int,
    margin: float,
) -> Camera:
    """A camera whose square picture of `size` pixels holds all points.

    It stays where it is. Only where a point comes nearer than `NEAREST`, as an arm does of who
    films herself and is turned round, it steps straight back until none does, by `REACH` at most.

    Args:
        points: in the world.
        K: of the camera whose perspective is kept; only its crop and scale change.
        viewmat: where that camera is.
        size: width and height in pixels.
        margin: around the points, as a share of their box's longer side.

    Raises:
        ValueError: if somebody walks past it.
    """
    nearest = project(points, K, viewmat)[1].min()
    if nearest < NEAREST - REACH:
        raise ValueError("the person comes as far as the camera; lower animate.travel")
    if nearest < NEAREST:
        viewmat = viewmat.clone()
        viewmat[2, 3] += NEAREST - nearest
    flat = project(points, K, viewmat)[0].reshape(-1, 2)
    low, high = flat.min(0).values, flat.max(0).values
    half = float((high - low).max()) * (0.5 + margin)
    corner = (low + high) / 2 - half
    K = crop_intrinsics(K, float(corner[0]), float(corner[1]), size / (2 * half))
    return Camera(K, viewmat, size, size)


def _heading(rotation: Float[Tensor, "3 3"]) -> Float[Tensor, ""]:
    """Angle about +Y by which a body faces away from +Z."""
    return torch.atan2(rotation[0, 2], rotation[2, 2])
