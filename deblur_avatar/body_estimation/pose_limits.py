"""Joint limits: how far human joints turn, roughly.

Conventions. A joint's axis-angle vector in rest-pose axes (+X left, +Y up, +Z front; T-pose) is
held between two corners of a box, in degrees, and drawn towards zero. This is coarse: it is there
to keep what no camera shows from becoming a contortion, not to model anatomy.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES

Range = tuple[float, float]


class _Limit(NamedTuple):
    joint: str  # left or middle; the right mirrors it
    x: Range  # for legs: + bends the knee, - lifts the thigh
    y: Range
    z: Range
    std: float  # degrees about zero, where nothing else is known


_LIMITS = (
    _Limit("left_hip", (-130, 45), (-50, 50), (-35, 75), 40),
    _Limit("left_knee", (-5, 150), (-15, 15), (-10, 10), 50),
    _Limit("left_ankle", (-50, 50), (-25, 25), (-30, 30), 20),
    _Limit("left_foot", (-30, 30), (-5, 5), (-5, 5), 5),
    _Limit("spine1", (-20, 40), (-20, 20), (-25, 25), 12),
    _Limit("spine2", (-15, 30), (-20, 20), (-20, 20), 10),
    _Limit("spine3", (-15, 20), (-20, 20), (-20, 20), 10),
    _Limit("neck", (-35, 40), (-45, 45), (-30, 30), 15),
    _Limit("head", (-30, 30), (-40, 40), (-25, 25), 15),
    _Limit("left_collar", (-15, 15), (-20, 20), (-15, 30), 10),
    _Limit("left_shoulder", (-90, 90), (-130, 60), (-100, 90), 60),
    _Limit("left_elbow", (-90, 90), (-155, 5), (-20, 20), 50),
    _Limit("left_wrist", (-45, 45), (-35, 35), (-75, 75), 20),
    _Limit("left_hand", (-10, 10), (-10, 10), (-10, 10), 5),
)
_SEEN_HAND = _Limit("left_hand", (-10, 10), (-10, 10), (-110, 20), 25)  # its fingers bend, as one


class PoseLimits(NamedTuple):
    """Boxes for joints 1 to J - 1, radians."""

    low: Float[Tensor, "K 3"]
    high: Float[Tensor, "K 3"]
    std: Float[Tensor, " K"]


def pose_limits(seen_hands: tuple[str, ...] = ()) -> PoseLimits:
    """The table above for both sides of the body.

    A right joint's rotation is the left one's seen in a mirror: y and z change sign.

    Args:
        seen_hands: `left_hand`, `right_hand`: those whose fingers may bend, being seen.
    """
    limits = {limit.joint: limit for limit in _LIMITS}
    low, high, std = [], [], []
    for name in SMPL_JOINT_NAMES[1:]:
        limit = _SEEN_HAND if name in seen_hands else limits[name.replace("right", "left")]
        x, y, z = limit.x, limit.y, limit.z
        if name.startswith("right"):
            y, z = (-y[1], -y[0]), (-z[1], -z[0])
        low.append([x[0], y[0], z[0]])
        high.append([x[1], y[1], z[1]])
        std.append(limit.std)
    box = torch.deg2rad(torch.tensor([low, high], dtype=torch.float32))
    return PoseLimits(box[0], box[1], torch.deg2rad(torch.tensor(std, dtype=torch.float32)))
