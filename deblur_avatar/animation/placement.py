"""Placement: a moving body, upright in front of the camera that filmed the person.

Conventions. The stage is the person's own: +Y up, +Z horizontally towards the camera, +X to the
left of who faces the camera.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.centre_of_mass import centre_of_mass
from deblur_avatar.bodies.posed_body import posed, shaped_joints
from deblur_avatar.geometry.cameras import (
    camera_centres,
    crop_intrinsics,
    look_at,
    project,
)
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

NEAR_AXIS = math.radians(30)  # a person leans less than that on average
LIES = math.radians(40)  # sideways in the picture: more, and she does not stand
LEVEL = math.radians(12)  # sideways on average: less is her lean, more a camera held askew
IN_PICTURE = 0.5  # as little of the way from soles to centre of mass is seen from above
STEEPEST = math.radians(60)  # that a camera looks down on who stands
UPWARDS = math.radians(30)  # that it looks up: more, and she lies with her head away
STANDS = 0.5  # share of the frames: less, and how she stands tells nothing of the whole
PELVIS, NECK, *SOLES = (
    SMPL_JOINT_NAMES.index(name)
    for name in ("pelvis", "neck", "left_ankle", "right_ankle", "left_foot", "right_foot")
)


def stage_rotation(
    joints: Float[Tensor, "F J 3"], viewmat: Float[Tensor, "4 4"]
) -> Float[Tensor, "3 3"]:
    """Rotation `world_from_stage`, found from how the person stood while it was filmed.

    Args:
        joints: of the filmed person, in the world.
        viewmat: of the camera that filmed it.

    Raises:
        ValueError: if the camera looks straight down on the person or up at it.
    """
    up = up_direction(joints, viewmat)
    pelvis = joints[:, 0].mean(0)
    towards = camera_centres(viewmat) - pelvis
    ahead = towards - (towards @ up) * up
    if ahead.norm() < 1e-3 * towards.norm():
        raise ValueError("the camera looks along the person's vertical; no side is in front")
    ahead = torch.nn.functional.normalize(ahead, dim=0)
    return torch.stack([torch.linalg.cross(up, ahead), up, ahead], dim=1)


def up_direction(
    joints: Float[Tensor, "F J 3"], viewmat: Float[Tensor, "4 4"]
) -> Float[Tensor, " 3"]:
    """Unit vector against gravity, in the world, as far as the filmed person tells it.

    Who stands has the centre of mass above the soles, wrong of who sits, and the neck above the
    pelvis, wrong of who bends. Calibrations mostly have an axis along gravity: up is an axis within
    `NEAR_AXIS` of either way's mean, of two the one nearer to the picture's up, and of none the
    mean way from soles to centre. A world that is the camera's own has no such axis. There up is
    turned from the picture's as the median frame is, forth and sideways, by the way that is nearer
    to a level camera; sideways only by more than `LEVEL`, since people lean.

    Frames in which she lies sideways in the picture do not count. Where fewer than `STANDS` are
    left or, in the camera's own world, as few of these agree, up is the picture's.
    """
    ways = _ways_up(joints) @ viewmat[:3, :3].T
    whole = ways[0]
    from_above = whole[:, :2].norm(dim=1) <= IN_PICTURE
    stands = from_above | (torch.atan2(whole[:, 0], -whole[:, 1]).abs() <= LIES)
    picture_up = -viewmat[1, :3]
    means = [picture_up]
    if stands.float().mean() >= STANDS:
        if torch.equal(viewmat[:3, :3], torch.eye(3).to(viewmat)):
            return _up_of_camera(ways[:, stands])
        means = list(ways[:, stands].mean(1) @ viewmat[:3, :3])
        means = [torch.nn.functional.normalize(mean, dim=0) for mean in means]
    axes = [axis for mean in means if mean @ (axis := _nearest_axis(mean)) > math.cos(NEAR_AXIS)]
    return max(axes, key=lambda axis: axis @ picture_up, default=means[0])


def _nearest_axis(way: Float[Tensor, " 3"]) -> Float[Tensor, " 3"]:
    axis = torch.zeros_like(way)
    axis[way.abs().argmax()] = way[way.abs().argmax()].sign()
    return axis


def _up_of_camera(ways: Float[Tensor, "2 F 3"]) -> Float[Tensor, " 3"]:
    """Up in a camera's own axes, of whole bodies and trunks that stand before it."""
    turned = torch.atan2(ways[..., [0, 2]], -ways[..., 1:2]).median(dim=1).values
    roll, pitch = (min(pair, key=abs) for pair in turned.T)
    roll = torch.where(roll.abs() > LEVEL, roll, 0.0)
    up = torch.stack([roll.tan(), -torch.ones_like(roll), pitch.tan()])
    up = torch.nn.functional.normalize(up, dim=0)
    agree = (ways[0] @ up >= math.cos(LIES)).float().mean() >= STANDS
    if not agree or not -STEEPEST < pitch < UPWARDS:
        return up.new_tensor([0.0, -1.0, 0.0])
    return up


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
    joints = posed(body, filmed).joints
    anchor = joints[:, 0].mean(0)
    world_from_stage = stage_rotation(joints, viewmat)
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
    joints = posed(body, filmed).joints
    up = stage_rotation(joints, viewmat)[:, 1]
    return look_at(camera_centres(viewmat), joints[:, 0].mean(0), up)


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


def _ways_up(joints: Float[Tensor, "F J 3"]) -> Float[Tensor, "2 F 3"]:
    """Unit vectors from the soles to the centre of mass, and along the trunk."""
    whole = centre_of_mass(joints) - joints[:, SOLES].mean(1)
    trunk = joints[:, NECK] - joints[:, PELVIS]
    return torch.nn.functional.normalize(torch.stack([whole, trunk]), dim=-1)
