"""Built-in motions: functions of time, so that they exist at any frame rate.

Conventions. SMPL's joints and axes: the T-pose has the left arm along +X, +Y is up, +Z in front; a
positive turn about z raises the left arm and opens the left leg, a positive turn about x bends a
knee. Angles in the tables are degrees.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.errors import ConfigError

_INDEX = {name: index for index, name in enumerate(SMPL_JOINT_NAMES)}
_MIRROR = {"x": 1.0, "y": -1.0, "z": -1.0}  # how the right side turns when it mirrors the left

JACK_SECONDS = 1.1  # from one landing with feet together to the next
JUMP_METRES = 0.10  # how high the feet come


def builtin_motion(name: str, fps: float, start: float, seconds: float) -> BodyMotion:
    """Sample a motion by name from `start` on.

    Raises:
        ConfigError: if there is none of that name.
    """
    if name not in BUILTIN_MOTIONS:
        raise ConfigError(
            f"no built-in motion {name!r}; there are {', '.join(BUILTIN_MOTIONS)}, or give a file"
        )
    count = math.floor(seconds * fps + 1e-6) + 1
    times = start + torch.arange(count, dtype=torch.float64) / fps
    axis_angle, transl = BUILTIN_MOTIONS[name](times)
    return BodyMotion(
        fps=fps,
        global_orient=axis_angle[:, 0].float(),
        body_pose=axis_angle[:, 1:].float(),
        transl=transl.float(),
    )


def jumping_jacks(
    times: Float[Tensor, " F"],
) -> tuple[Float[Tensor, "F 24 3"], Float[Tensor, "F 3"]]:
    """Arms and legs open and close in jumps, while the chest twists from side to side."""
    phase = 2 * math.pi * times / JACK_SECONDS
    opened = (1 - phase.cos()) / 2  # 0 with feet together, 1 with feet apart
    landed = phase.cos().square()  # 1 at both landings, 0 in the air
    twisted = (phase / 2).sin()
    pose = times.new_zeros(len(times), len(SMPL_JOINT_NAMES), 3)
    _both_sides(pose, "collar", z=15 * opened)
    _both_sides(pose, "shoulder", z=-72 + 125 * opened, x=6 * landed)
    _both_sides(pose, "elbow", y=-18 - 20 * (1 - opened) * opened)
    # Hip, knee and ankle share the bend of a landing so that the sole stays level.
    _both_sides(pose, "hip", z=4 + 20 * opened, x=-6 - 14 * landed)
    _both_sides(pose, "knee", x=12 + 28 * landed)
    _both_sides(pose, "ankle", x=-6 - 14 * landed)
    for joint, share in (("spine1", 6.0), ("spine2", 6.0), ("spine3", 8.0), ("neck", -6.0)):
        pose[:, _INDEX[joint], 1] = torch.deg2rad(share * twisted)
    transl = times.new_zeros(len(times), 3)
    transl[:, 1] = JUMP_METRES * (1 - landed) - 0.05 * opened - 0.03 * landed
    return pose, transl


def _both_sides(pose: Float[Tensor, "F 24 3"], joint: str, **degrees: Tensor) -> None:
    """Set a left joint's angles and their mirror images on the right; about few axes only."""
    for axis, angle in degrees.items():
        column = "xyz".index(axis)
        pose[:, _INDEX[f"left_{joint}"], column] = torch.deg2rad(angle)
        pose[:, _INDEX[f"right_{joint}"], column] = _MIRROR[axis] * torch.deg2rad(angle)


BUILTIN_MOTIONS = {"jumping_jacks": jumping_jacks}
