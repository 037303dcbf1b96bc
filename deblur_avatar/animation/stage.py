"""Stage: where a person was filmed, which way was up, and from which side the camera looked.

Conventions. The stage's axes are the person's own: +Y up, +Z horizontally towards the camera, +X to
the left of who faces the camera.
"""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.bodies.centre_of_mass import centre_of_mass
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.geometry.cameras import camera_centres

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


@dataclass(frozen=True)
class Stage:
    """Where a person was filmed, and the axes to see her in."""

    anchor: Float[Tensor, " 3"]  # where her pelvis was on average, in the world, metres
    world_from_stage: Float[Tensor, "3 3"]

    @property
    def up(self) -> Float[Tensor, " 3"]:
        """Unit vector against gravity, in the world."""
        return self.world_from_stage[:, 1]


def stage_of_clip(observations: Observations, betas: Float[Tensor, " B"]) -> Stage:
    """The stage of a clip: of the poses that fitting started from, in a fitted shape.

    Raises:
        ValueError: as `stage_of`.
    """
    return stage_of(
        _joints_filmed(observations, betas), observations.camera.viewmat,
        world_is_a_cameras=observations.cameras.world_is_a_cameras,
    )  # fmt: skip


def up_of_clip(observations: Observations, betas: Float[Tensor, " B"]) -> Float[Tensor, " 3"]:
    """Unit vector against gravity, in the world: the stage's, which every clip has."""
    return up_direction(
        _joints_filmed(observations, betas), observations.camera.viewmat,
        world_is_a_cameras=observations.cameras.world_is_a_cameras,
    )  # fmt: skip


def _joints_filmed(
    observations: Observations, betas: Float[Tensor, " B"]
) -> Float[Tensor, "F J 3"]:
    """In the poses that fitting started from."""
    return posed(observations.body, replace(observations.poses, betas=betas)).joints


def stage_of(
    joints: Float[Tensor, "F J 3"], viewmat: Float[Tensor, "4 4"], *, world_is_a_cameras: bool
) -> Stage:
    """Find the stage from how a person stood while she was filmed.

    Args:
        joints: of the filmed person, in the world.
        viewmat: of the camera that filmed her.
        world_is_a_cameras: as `Cameras` say: no axis of the world is along gravity but by chance.

    Raises:
        ValueError: if the camera looks straight down on the person or up at her.
    """
    up = up_direction(joints, viewmat, world_is_a_cameras=world_is_a_cameras)
    anchor = joints[:, 0].mean(0)
    towards = camera_centres(viewmat) - anchor
    ahead = towards - (towards @ up) * up
    if ahead.norm() < 1e-3 * towards.norm():
        raise ValueError("the camera looks along the person's vertical; no side is in front")
    ahead = torch.nn.functional.normalize(ahead, dim=0)
    return Stage(anchor, torch.stack([torch.linalg.cross(up, ahead), up, ahead], dim=1))


def up_direction(
    joints: Float[Tensor, "F J 3"], viewmat: Float[Tensor, "4 4"], *, world_is_a_cameras: bool
) -> Float[Tensor, " 3"]:
    """Unit vector against gravity, in the world, as far as the filmed person tells it.

    Who stands has the centre of mass above the soles, wrong of who sits, and the neck above the
    pelvis, wrong of who bends. Calibrations mostly have an axis along gravity: up is an axis within
    `NEAR_AXIS` of either way's mean, of two the one nearer to the picture's up, and of none the
    mean way from soles to centre. A world that is a camera's, this one's or another's, has no such
    axis. There up is turned from the picture's as the median frame is, forth and sideways, by the
    way that is nearer to a level camera; sideways only by more than `LEVEL`, since people lean.

    Frames in which she lies sideways in the picture do not count. Where fewer than `STANDS` are
    left or, in a camera's world, as few of these agree, up is the picture's.
    """
    ways = _ways_up(joints) @ viewmat[:3, :3].T
    whole = ways[0]
    from_above = whole[:, :2].norm(dim=1) <= IN_PICTURE
    stands = from_above | (torch.atan2(whole[:, 0], -whole[:, 1]).abs() <= LIES)
    tells = bool(stands.float().mean() >= STANDS)
    picture_up = -viewmat[1, :3]
    if world_is_a_cameras:
        return _up_of_camera(ways[:, stands]) @ viewmat[:3, :3] if tells else picture_up
    means = [picture_up]
    if tells:
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


def _ways_up(joints: Float[Tensor, "F J 3"]) -> Float[Tensor, "2 F 3"]:
    """Unit vectors from the soles to the centre of mass, and along the trunk."""
    whole = centre_of_mass(joints) - joints[:, SOLES].mean(1)
    trunk = joints[:, NECK] - joints[:, PELVIS]
    return torch.nn.functional.normalize(torch.stack([whole, trunk]), dim=-1)
