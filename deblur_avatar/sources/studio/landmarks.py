"""Where on a resting body garments begin and end, whatever the body.

Conventions. The rest pose of `Body`: T-pose, +Y up, facing +Z, the left hand towards +X, metres.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deblur_avatar.artifacts import SMPL_JOINT_NAMES

HEAD = SMPL_JOINT_NAMES.index("head")


@dataclass(frozen=True)
class Landmarks:
    """Heights and reaches of a resting body; left stands for both sides."""

    joints: Float[np.ndarray, "J 3"]
    head_size: float  # from the head's joint to the crown

    def of(self, name: str) -> Float[np.ndarray, " 3"]:
        """Where a joint rests."""
        return self.joints[SMPL_JOINT_NAMES.index(name)]

    def in_head(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Positions relative to the head's joint in units of the head's size."""
        return (points - self.of("head")) / self.head_size


def find_landmarks(
    vertices: Float[np.ndarray, "P 3"],
    joints: Float[np.ndarray, "J 3"],
    lbs_weights: Float[np.ndarray, "P J"],
) -> Landmarks:
    """Measure a resting body."""
    head = vertices[lbs_weights.argmax(1) == HEAD]
    return Landmarks(joints, float(head[:, 1].max() - joints[HEAD, 1]))


def rise(values: Float[np.ndarray, " N"], low: float, high: float) -> Float[np.ndarray, " N"]:
    """From 0 at `low` to 1 at `high` without a corner; `low` may be above `high`."""
    share = np.clip((values - low) / (high - low), 0, 1)
    return share * share * (3 - 2 * share)
