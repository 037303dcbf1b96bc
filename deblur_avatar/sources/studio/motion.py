"""Studio motions: smooth functions of time.

Conventions. SMPL's pose: axis-angle, radians, metres, each joint relative to its parent; +Y up, at
rest facing +Z, the left hand towards +X. The floor is at y = 0 for an adult of ordinary height.
Times are in seconds from the start of the clip; M instants, K = 23 joints below the pelvis.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_multiply,
    quat_to_axis_angle,
)

STANDING = 0.965  # metres from the floor to the pelvis
KICK_PERIOD = 1.2  # seconds from one kick of a leg to its next
KICK_SPREAD = 0.105  # seconds, the standard deviation of a kick's bump
X, Y, Z = range(3)


@dataclass(frozen=True)
class Moves:
    """Poses at M instants."""

    global_orient: Float[Tensor, "M 3"]
    body_pose: Float[Tensor, "M K 3"]
    transl: Float[Tensor, "M 3"]
    swing: Float[Tensor, "M J 3"] | None = None  # of the cloth around each joint (`Drape.skinned`)

    @property
    def axis_angle(self) -> Float[Tensor, "M J 3"]:
        """Rotations of all joints relative to their parents, the root's first."""
        return torch.cat([self.global_orient[:, None], self.body_pose], dim=1)

    def poses(self, betas: Float[Tensor, " B"]) -> Poses:
        """The same as an artifact, of a body of that shape."""
        return Poses(
            betas=betas,
            global_orient=self.global_orient.float(),
            body_pose=self.body_pose.float(),
            transl=self.transl.float(),
        )


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
    constant = torch.ones_like(times)
    turns = {
        "left_shoulder": [(Z, -1.0 * constant)],
        "right_shoulder": [(Z, 1.0 * constant)],
        "left_elbow": [(Y, -0.4 * constant)],
        "right_elbow": [(Y, 0.4 * constant)],
    }
    place = constant[:, None] * constant.new_tensor([0.0, STANDING, 0.0])
    return _moves(turns, [(Y, 0.4 * constant)], place)


def turn(times: Float[Tensor, " M"], training_seconds: float) -> Moves:
    """Turn once around in the training part, swinging the arms and kicking right, then left.

    The kicks come every 0.6 s, their feet at up to 8 m/s. After the training part the turn goes on,
    the arms rise to the sides and the right knee is drawn up.
    """
    ending = torch.sigmoid((times - training_seconds) / 0.05)  # 1 after the training part
    swing = torch.sin(2 * torch.pi * times / 0.64 + 0.4) * (1 - 0.5 * ending)
    breath = torch.sin(2 * torch.pi * times / 1.1)
    right, left = _kicks(times, 0.34), _kicks(times, 0.94)
    # The knee is cocked before the foot flies; once held out, it stays bent.
    cock = _kicks(times, 0.25) * (1 - 0.8 * right) * (1 - ending) + 1.3 * right * ending
    left_cock = _kicks(times, 0.85) * (1 - 0.8 * left)
    turns = {
        "left_hip": [(X, -0.1 - 1.15 * left - 0.25 * left_cock), (Z, 0.06 + 0.12 * left)],
        "right_hip": [(X, -0.1 - 1.15 * right - 0.25 * cock), (Z, -0.06 - 0.12 * right)],
        "left_knee": [(X, 0.22 + 1.2 * left_cock)],
        "right_knee": [(X, 0.22 + 1.2 * cock)],
        "left_ankle": [(X, -0.12 + 0.5 * left)],
        "right_ankle": [(X, -0.12 + 0.5 * right)],
        "spine1": [(X, 0.05 + 0.12 * (left + right)), (Y, 0.12 * swing)],
        "spine2": [(Y, 0.14 * swing), (Z, 0.06 * breath)],
        "spine3": [(Y, 0.12 * swing)],
        "neck": [(Y, -0.15 * swing), (X, 0.08 * breath)],
        "head": [(Y, -0.12 * swing)],
        "left_shoulder": [(Z, -0.85 + 0.25 * breath + 0.75 * ending), (X, -0.2 - 0.85 * swing)],
        "right_shoulder": [(Z, 0.85 - 0.25 * breath - 0.55 * ending), (X, -0.2 + 0.85 * swing)],
        "left_elbow": [(Y, -0.65 - 0.45 * swing)],
        "right_elbow": [(Y, 0.65 - 0.45 * swing)],
        "left_wrist": [(Z, 0.2 * swing)],
        "right_wrist": [(Z, -0.2 * swing)],
    }
    around = 2 * torch.pi * times / training_seconds
    place = [
        0.03 * torch.sin(2 * torch.pi * times / 1.2),
        STANDING - 0.02 + 0.02 * torch.cos(2 * torch.pi * times / 0.6 + 0.5),
        0.03 * torch.cos(2 * torch.pi * times / 1.5),
    ]
    orient = [(Y, around), (Z, 0.05 * (left - right))]
    return _moves(turns, orient, torch.stack(place, -1))


def walk(times: Float[Tensor, " M"], training_seconds: float) -> Moves:
    """Walk on the spot, two steps a second, facing forward; arms swing against the legs."""
    stride = torch.sin(2 * torch.pi * times)
    left, right = ((0.5 - side * 0.5 * torch.cos(2 * torch.pi * times)) ** 2 for side in (1, -1))
    constant = torch.ones_like(times)
    turns = {
        "left_hip": [(X, -0.45 * stride)],
        "right_hip": [(X, 0.45 * stride)],
        "left_knee": [(X, 0.1 + 0.9 * left)],
        "right_knee": [(X, 0.1 + 0.9 * right)],
        "left_shoulder": [(Z, -1.25 * constant), (X, 0.5 * stride)],
        "right_shoulder": [(Z, 1.25 * constant), (X, -0.5 * stride)],
        "left_elbow": [(Y, -0.35 * constant)],
        "right_elbow": [(Y, 0.35 * constant)],
        "spine2": [(Y, 0.12 * stride)],
    }
    height = STANDING - 0.025 + 0.02 * torch.cos(4 * torch.pi * times)
    return _moves(turns, [(Y, 0 * times)], torch.stack([0 * times, height, 0 * times], -1))


MOTIONS: dict[str, Motion] = {"turn": turn, "still": still, "walk": walk}


def _kicks(times: Float[Tensor, " M"], first: float) -> Float[Tensor, " M"]:
    """A bump of height 1, a quarter of a second wide at half height, at `first` and every 1.2 s."""
    distance = torch.sin(torch.pi * (times - first) / KICK_PERIOD) * KICK_PERIOD / torch.pi
    return torch.exp(-0.5 * (distance / KICK_SPREAD) ** 2)


def _moves(
    turns: dict[str, list[tuple[int, Tensor]]],
    orient: list[tuple[int, Tensor]],
    transl: Float[Tensor, "M 3"],
) -> Moves:
    """Compose rotations about fixed axes, the first one first."""
    axis_angle = transl.new_zeros(len(transl), len(SMPL_JOINT_NAMES), 3)
    for name, steps in {"pelvis": orient, **turns}.items():
        total = axis_angle_to_quat(torch.zeros_like(transl))
        for axis, angle in steps:
            step = torch.zeros_like(transl)
            step[:, axis] = angle
            total = quat_multiply(axis_angle_to_quat(step), total)
        axis_angle[:, SMPL_JOINT_NAMES.index(name)] = quat_to_axis_angle(total)
    return Moves(axis_angle[:, 0], axis_angle[:, 1:], transl)
