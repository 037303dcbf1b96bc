"""Placement: a moving body, upright in front of the camera that filmed the person.

Conventions. The stage is the person's own: +Y up, +Z horizontally towards the camera, +X to the
left of who faces the camera.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed, shaped_joints
from deblur_avatar.geometry.cameras import (
    camera_centres,
    crop_intrinsics,
    look_at,
    project,
)
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

NEAR_AXIS = math.radians(30)  # a person leans less than that on average
LIES = math.radians(40)  # sideways in the picture, on average: more, and she does not stand
IN_PICTURE = 0.5  # as little of the way from feet to head is seen from above


def stage_rotation(
    filmed: Poses, pelvis: Float[Tensor, " 3"], viewmat: Float[Tensor, "4 4"]
) -> Float[Tensor, "3 3"]:
    """Rotation `world_from_stage`, found from how the person stood while it was filmed.

    Up is the axis of the world that is nearest to the mean direction of the person's own up, since
    calibrations mostly have an axis along gravity and people lean; where none is within
    `NEAR_AXIS` it is that mean direction. Who lies sideways in the picture does not tell: there the
    picture's up stands in for her own, since people hold cameras level.

    Raises:
        ValueError: if the camera looks straight down on the person or up at it.
    """
    up = axis_angle_to_matrix(filmed.global_orient)[..., 1].mean(0)
    up = torch.nn.functional.normalize(up, dim=0)
    sideways, down, _ = (viewmat[:3, :3] @ up).tolist()
    if math.hypot(sideways, down) > IN_PICTURE and abs(math.atan2(sideways, -down)) > LIES:
        up = -viewmat[1, :3]
    axis = torch.zeros_like(up)
    axis[up.abs().argmax()] = up[up.abs().argmax()].sign()
    up = axis if up @ axis > math.cos(NEAR_AXIS) else up
    towards = camera_centres(viewmat) - pelvis
    ahead = towards - (towards @ up) * up
    if ahead.norm() < 1e-3 * towards.norm():
        raise ValueError("the camera looks along the person's vertical; no side is in front")
    ahead = torch.nn.functional.normalize(ahead, dim=0)
    return torch.stack([torch.linalg.cross(up, ahead), up, ahead], dim=1)


def place(
    motion: BodyMotion,
    body: Body,
    filmed: Poses,
    viewmat: Float[Tensor, "4 4"],
    *,
    turns: float,
    travel: float,
) -> Poses:
    """Let the filmed person do the motion where it was filmed, facing the camera at the start.

    The first frame's heading is taken out, its lean against the vertical stays.

    Args:
        motion: what to do.
        body: the filmed person's body.
        filmed: poses of the person while it was filmed; its shape is kept.
        viewmat: the camera that filmed it.
        turns: how often the stage turns from the first frame to the last, as if the camera went
            round, so that every side is seen.
        travel: share of the motion's horizontal path that is kept, 0 for motion on the spot.

    Raises:
        ValueError: as `stage_rotation`.
    """
    anchor = mean_pelvis(body, filmed)
    world_from_stage = stage_rotation(filmed, anchor, viewmat)
    orientation = axis_angle_to_matrix(motion.global_orient)
    heading = -_heading(orientation[0])
    share = torch.linspace(0, 1, len(orientation)) if len(orientation) > 1 else torch.zeros(1)
    turned = world_from_stage @ about_y(heading + 2 * math.pi * turns * share)
    path = motion.transl - motion.transl.median(dim=0).values
    path = path * path.new_tensor([travel, 1.0, travel])
    path = (turned @ path[..., None])[..., 0]
    return Poses(
        betas=filmed.betas,
        global_orient=matrix_to_axis_angle(turned @ orientation),
        body_pose=motion.body_pose,
        transl=anchor + path - shaped_joints(body, filmed.betas)[0],
    )


def level_view(body: Body, filmed: Poses, viewmat: Float[Tensor, "4 4"]) -> Float[Tensor, "4 4"]:
    """Turn a camera, where it stands, towards the person and upright.

    Raises:
        ValueError: as `stage_rotation`.
    """
    pelvis = mean_pelvis(body, filmed)
    up = stage_rotation(filmed, pelvis, viewmat)[:, 1]
    return look_at(camera_centres(viewmat), pelvis, up)


def mean_pelvis(body: Body, filmed: Poses) -> Float[Tensor, " 3"]:
    """Where the person was on average."""
    return posed(body, filmed).joints[:, 0].mean(0)


def about_y(angles: Float[Tensor, " F"]) -> Float[Tensor, "F 3 3"]:
    """Rotations about the vertical."""
    still = torch.zeros_like(angles)
    return axis_angle_to_matrix(torch.stack([still, angles, still], dim=-1))


def framed_intrinsics(
    points: Float[Tensor, "*batch P 3"],
    K: Float[Tensor, "3 3"],
    viewmat: Float[Tensor, "4 4"],
    size: int,
    margin: float,
) -> Float[Tensor, "3 3"]:
    """Intrinsics of a square picture of `size` pixels that holds all points, seen from one place.

    Args:
        points: in the world.
        K: of the camera whose place and perspective is kept; only its crop and scale change.
        viewmat: where the camera is.
        size: width and height in pixels.
        margin: around the points, as a share of their box's longer side.

    Raises:
        ValueError: if a point is behind the camera.
    """
    pixels, depth = project(points, K, viewmat)
    if depth.min() <= 0:
        raise ValueError("the person comes as far as the camera; lower animate.travel")
    flat = pixels.reshape(-1, 2)
    low, high = flat.min(0).values, flat.max(0).values
    half = float((high - low).max()) * (0.5 + margin)
    corner = (low + high) / 2 - half
    return crop_intrinsics(K, float(corner[0]), float(corner[1]), size / (2 * half))


def _heading(rotation: Float[Tensor, "3 3"]) -> Float[Tensor, ""]:
    """Angle about +Y by which a body faces away from +Z."""
    return torch.atan2(rotation[0, 2], rotation[2, 2])
