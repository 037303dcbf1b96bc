"""Landmark regression: which point of the body each of the detector's landmarks is.

A landmark is a point of the rest pose glued to one joint, its carrier: the rest position of an
anchor joint plus an offset. For limbs the anchor is the joint of the same name, and its carrier the
joint's parent, which holds it wherever it turns. Detectors see joints near the skin where bodies
have them inside, so offsets are fitted once a person, the right side mirroring the left. Of
MediaPipe's 33 landmarks those of the eyes, the mouth, thumbs and little fingers tell nothing more
and are not used. Metres, rest-pose axes (+X left, +Y up, +Z front).
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES


class _Mark(NamedTuple):
    landmark: int  # MediaPipe's number of the left or the only one
    carrier: str
    anchor: str
    offset: tuple[float, float, float]  # expected
    std: float  # standard deviation of the offset about that


JOINT_SPREAD = 0.02  # how far a detector's idea of a joint is from a body model's
SKIN_SPREAD = 0.03  # of points on the skin, whose place depends on the body's shape too

_MARKS = (
    _Mark(0, "head", "head", (0.0, 0.05, 0.14), SKIN_SPREAD),  # nose
    _Mark(7, "head", "head", (0.08, 0.07, 0.01), SKIN_SPREAD),  # ear
    _Mark(11, "left_collar", "left_shoulder", (0.0, 0.0, 0.0), JOINT_SPREAD),
    _Mark(13, "left_shoulder", "left_elbow", (0.0, 0.0, 0.0), JOINT_SPREAD),
    _Mark(15, "left_elbow", "left_wrist", (0.0, 0.0, 0.0), JOINT_SPREAD),
    _Mark(19, "left_wrist", "left_hand", (0.03, 0.0, 0.02), SKIN_SPREAD),  # index finger
    _Mark(23, "pelvis", "left_hip", (0.0, 0.0, 0.0), JOINT_SPREAD),
    _Mark(25, "left_hip", "left_knee", (0.0, 0.0, 0.0), JOINT_SPREAD),
    _Mark(27, "left_knee", "left_ankle", (0.0, 0.0, 0.0), JOINT_SPREAD),
    _Mark(29, "left_ankle", "left_ankle", (0.0, -0.05, -0.05), SKIN_SPREAD),  # heel
    _Mark(31, "left_ankle", "left_foot", (0.0, -0.01, 0.04), SKIN_SPREAD),  # big toe
)
_MIDDLE = (0,)  # landmarks without a left and a right

TORSO = ((11, "left_shoulder"), (12, "right_shoulder"), (23, "left_hip"), (24, "right_hip"))


class LandmarkMap(NamedTuple):
    """Rows of used landmarks, and where on the body they are; L of them, M offsets to fit."""

    rows: tuple[int, ...]  # in the detector's order of landmarks
    carriers: tuple[int, ...]  # joints
    anchors: tuple[int, ...]  # joints
    shared: tuple[int, ...]  # which of the M offsets each landmark has
    mirror: Float[Tensor, "L 3"]  # -1 where the offset is mirrored
    offsets: Float[Tensor, "M 3"]  # expected, metres
    stds: Float[Tensor, " M"]  # metres

    def positions(
        self,
        joint_transforms: Float[Tensor, "F J 4 4"],
        joints: Float[Tensor, "J 3"],
        offsets: Float[Tensor, "M 3"],
    ) -> Float[Tensor, "F L 3"]:
        """Where the landmarks of a posed body are, metres.

        Args:
            joint_transforms: rest to posed.
            joints: rest positions.
            offsets: of this person.
        """
        rest = joints[list(self.anchors)] + self.mirror * offsets[list(self.shared)]
        carrying = joint_transforms[:, list(self.carriers)]
        return (carrying[..., :3, :3] @ rest[..., None])[..., 0] + carrying[..., :3, 3]


def landmark_map() -> LandmarkMap:
    """The table above for both sides of the body."""
    rows, carriers, anchors, shared, mirror = [], [], [], [], []
    for index, mark in enumerate(_MARKS):
        sides = ("left",) if mark.landmark in _MIDDLE else ("left", "right")
        for side in sides:
            right = side == "right"
            rows.append(mark.landmark + right)  # MediaPipe numbers the right one next
            carriers.append(SMPL_JOINT_NAMES.index(mark.carrier.replace("left", side)))
            anchors.append(SMPL_JOINT_NAMES.index(mark.anchor.replace("left", side)))
            shared.append(index)
            mirror.append([-1.0 if right else 1.0, 1.0, 1.0])
    return LandmarkMap(
        rows=tuple(rows),
        carriers=tuple(carriers),
        anchors=tuple(anchors),
        shared=tuple(shared),
        mirror=torch.tensor(mirror),
        offsets=torch.tensor([mark.offset for mark in _MARKS]),
        stds=torch.tensor([mark.std for mark in _MARKS]),
    )
