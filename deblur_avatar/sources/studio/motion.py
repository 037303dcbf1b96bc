"""What the person does, as smooth functions of time.

Conventions. SMPL's pose: axis-angle, radians, metres, each joint relative to its parent; +Y up, at
rest facing +Z, the left hand towards +X. The floor is at y = 0 for an adult of ordinary height. Times
are in seconds from the start of the clip; M instants, K = 23 joints below the pelvis.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts import SMPL_JOINT_NAMES
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_multiply,
    quat_to_axis_angle,
)

STANDING = 0.965  # metres from the floor to the pelvis
X, Y, Z = range(3)


@dataclass(frozen=True)
class Moves:
    """Poses at M instants."""

    global_orient: Float[Tensor, "M 3"]
    body_pose: Float[Tensor, "M K 3"]
    transl: Float[Tensor, "M 3"]


Motion = Callable[[Float[Tensor, " M"], float], Moves]


def move(name: str, times: Float[Tensor, " M"], training_seconds: float) -> Moves:
    """Evaluate a motion by name.

    Args:
        name: a key of `MOTIONS`.
        times: seconds; any, also outside the clip.
        training_seconds: length of the part of the clip that is not held out.

    Raises:
        ConfigError: for a name that is not known.
    """
    if name not in MOTIONS:
        raise ConfigError(f"no motion {name!r}; known: {', '.join(MOTIONS)}")
    return MOTIONS[name](times.double(), training_seconds)


def still(times: Float[Tensor, " M"], training_seconds: float) -> Moves:
    """Stand relaxed, turned a little; nothing moves."""
    turns = {
        "left_shoulder": [(Z, -1.0)], "right_shoulder": [(Z, 1.0)],
        "left_elbow": [(Y, -0.4)], "right_elbow": [(Y, 0.4)],
    }  # fmt: skip
    zero = torch.zeros_like(times)
    place = torch.stack([zero, zero + STANDING, zero], -1)
    return _moves(
        {name: [(a, zero + v) for a, v in t] for name, t in turns.items()}, [(Y, zero + 0.4)], place
    )


def turn(times: Float[Tensor, " M"], training_seconds: float) -> Moves:
    """Turn once around in the training part, swinging the arms and kicking right, then left.

    The kicks come every 0.6 s, their feet at 4 to 8 m/s. After the training part the turn goes on,
    the arms rise to the sides and a knee is drawn up.
    """
    later = (times - training_seconds) / 0.15
    ending = torch.sigmoid(later)  # 0 in the training part, 1 after it
    swing = torch.sin(2 * torch.pi * times / 0.64 + 0.4) * (1 - 0.6 * ending)
    breathe = torch.sin(2 * torch.pi * times / 1.1)
    right, left = _kicks(times, 0.34, 1.2), _kicks(times, 0.94, 1.2)
    right_cock, left_cock = _kicks(times - 0.01, 0.24, 1.2), _kicks(times - 0.01, 0.84, 1.2)
    turns = {
        "left_hip": [(X, -1.35 * left - 0.1 - 0.25 * left_cock), (Z, 0.06 + 0.12 * left)],
        "right_hip": [(X, -1.35 * right - 0.1 - 0.25 * right_cock), (Z, -0.06 - 0.12 * right)],
        "left_knee": [(X, 0.22 + 1.25 * left_cock * (1 - 0.8 * left))],
        "right_knee": [(X, 0.22 + 1.25 * right_cock * (1 - 0.8 * right))],
        "left_ankle": [(X, -0.12 + 0.5 * left)],
        "right_ankle": [(X, -0.12 + 0.5 * right)],
        "spine1": [(X, 0.05 + 0.12 * (left + right)), (Y, 0.12 * swing)],
        "spine2": [(Y, 0.14 * swing), (Z, 0.06 * breathe)],
        "spine3": [(Y, 0.12 * swing)],
        "neck": [(Y, -0.15 * swing), (X, 0.08 * breathe)],
        "head": [(Y, -0.12 * swing)],
        "left_shoulder": [
            (Z, -0.85 + 0.25 * breathe + 0.75 * ending), (X, -0.85 * swing - 0.2),
        ],
        "right_shoulder": [
            (Z, 0.85 - 0.25 * breathe - 0.55 * ending), (X, 0.85 * swing - 0.2),
        ],
        "left_elbow": [(Y, -0.65 - 0.45 * swing)],
        "right_elbow": [(Y, 0.65 - 0.45 * swing)],
        "left_wrist": [(Z, 0.2 * swing)],
        "right_wrist": [(Z, -0.2 * swing)],
    }  # fmt: skip
    around = 2 * torch.pi * times / training_seconds
    bob = STANDING - 0.02 + 0.02 * torch.cos(2 * torch.pi * times / 0.6 + 0.5)
    place = torch.stack(
        [
            0.05 * torch.sin(2 * torch.pi * times / 1.2),
            bob,
            0.04 * torch.cos(2 * torch.pi * times / 1.5),
        ],
        -1,
    )
    return _moves(turns, [(Y, around), (Z, 0.05 * (left - right))], place)


MOTIONS: dict[str, Motion] = {"turn": turn, "still": still}


def _kicks(times: Float[Tensor, " M"], middle: float, period: float) -> Float[Tensor, " M"]:
    """A bump of height 1 and half width 0.13 s at `middle` and every `period` from there."""
    phase = torch.pi * (times - middle) / period
    return torch.exp(-0.5 * (torch.sin(phase) * period / torch.pi / 0.105) ** 2)


def _moves(
    turns: dict[str, list[tuple[int, Tensor]]],
    orient: list[tuple[int, Tensor]],
    transl: Float[Tensor, "M 3"],
) -> Moves:
    """Compose rotations about fixed axes, the first one first."""
    axis_angle = transl.new_zeros(len(transl), len(SMPL_JOINT_NAMES), 3)
    for name, steps in {"pelvis": orient, **turns}.items():
        total = None
        for axis, angle in steps:
            step = torch.zeros(len(transl), 3, dtype=transl.dtype)
            step[:, axis] = angle
            quat = axis_angle_to_quat(step)
            total = quat if total is None else quat_multiply(quat, total)
        axis_angle[:, SMPL_JOINT_NAMES.index(name)] = quat_to_axis_angle(total)
    return Moves(axis_angle[:, 0], axis_angle[:, 1:], transl)
