"""The capsule body, for tests: SMPL's 24 joints, a few hundred vertices, built in milliseconds.

Conventions. `Body`'s own: T-pose, +Y up, facing +Z, the left hand towards +X, metres. The pelvis is
at the origin for every shape. Two shape numbers: beta 0 scales the body (5 % a unit), beta 1 makes
it stouter (10 % of each radius a unit).
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from deblur_avatar.artifacts.body import (
    SMPL_JOINT_NAMES,
    SMPL_PARENTS,
    Body,
)

SEGMENTS = 8  # around a capsule
CAP_RINGS = 2  # of each half sphere, its rim included, its pole not
BLEND = 0.3  # share of a bone at either end over which weights pass to the neighbour
GROWTH = 0.05  # of everything, a unit of beta 0
STOUTNESS = 0.1  # of the radii, a unit of beta 1

# The left half and the middle; right joints mirror theirs. Metres above and beside the pelvis.
_PLACES = {
    "pelvis": (0.0, 0.0, 0.0), "left_hip": (0.09, -0.08, 0.0), "left_knee": (0.10, -0.48, 0.0),
    "left_ankle": (0.10, -0.88, -0.03), "left_foot": (0.11, -0.93, 0.09),
    "spine1": (0.0, 0.11, -0.01), "spine2": (0.0, 0.24, 0.0), "spine3": (0.0, 0.32, 0.0),
    "neck": (0.0, 0.50, -0.02), "head": (0.0, 0.59, 0.01), "left_collar": (0.07, 0.43, -0.01),
    "left_shoulder": (0.18, 0.44, -0.01), "left_elbow": (0.44, 0.44, -0.02),
    "left_wrist": (0.69, 0.44, -0.01), "left_hand": (0.77, 0.44, -0.01),
}  # fmt: skip

# Joint that carries the capsule, joint at its far end or an offset from the first, radius.
_LEFT_AND_MIDDLE = (
    ("pelvis", "spine1", 0.14), ("spine1", "spine2", 0.125), ("spine3", "neck", 0.10),
    ("neck", "head", 0.055), ("head", (0.0, 0.13, 0.01), 0.09),
    ("left_collar", "left_shoulder", 0.065), ("left_shoulder", "left_elbow", 0.05),
    ("left_elbow", "left_wrist", 0.04), ("left_wrist", "left_hand", 0.04),
    ("left_hand", (0.07, 0.0, 0.0), 0.03),
    ("left_hip", "left_knee", 0.075), ("left_knee", "left_ankle", 0.055),
    ("left_ankle", "left_foot", 0.045), ("left_foot", (0.0, 0.0, 0.05), 0.035),
)  # fmt: skip


class _Capsule(NamedTuple):
    joint: int
    beyond: int | None  # the joint at the far end
    start: Tensor
    end: Tensor
    radius: float


def capsule_body() -> Body:
    """Build the body; the same every time, without textures or pose blend shapes."""
    joints = torch.tensor([_place(name) for name in SMPL_JOINT_NAMES], dtype=torch.float32)
    axes, normals, weights, faces, radii = [], [], [], [], []
    count = 0
    for capsule in _capsules(joints):
        along, around, triangles = _unit_capsule()
        axis = capsule.end - capsule.start
        normals.append(around @ _frame(axis))
        axes.append(capsule.start + along[:, None] * axis)
        radii.append(torch.full((len(along),), capsule.radius))
        weights.append(_weights(capsule, along))
        faces.append(triangles + count)
        count += len(along)
    outward = torch.cat(normals) * torch.cat(radii)[:, None]
    vertices = torch.cat(axes) + outward
    return Body(
        vertices=vertices,
        shape_dirs=torch.stack([GROWTH * vertices, STOUTNESS * outward], dim=-1),
        joints=joints,
        joint_dirs=torch.stack([GROWTH * joints, torch.zeros_like(joints)], dim=-1),
        pose_dirs=None,
        parents=SMPL_PARENTS,
        lbs_weights=torch.cat(weights),
        faces=torch.cat(faces),
        uvs=None,
        joint_names=SMPL_JOINT_NAMES,
        licence="Apache-2.0, part of deblur-avatar",
    )


def _place(name: str) -> tuple[float, float, float]:
    if name.startswith("right_"):
        x, y, z = _PLACES[name.replace("right_", "left_")]
        return -x, y, z
    return _PLACES[name]


def _capsules(joints: Float[Tensor, "J 3"]) -> list[_Capsule]:
    capsules = []
    for name, far, radius in _LEFT_AND_MIDDLE:
        for side in ("left_", "right_") if name.startswith("left_") else ("",):
            joint = SMPL_JOINT_NAMES.index(name.replace("left_", side))
            if isinstance(far, str):
                beyond = SMPL_JOINT_NAMES.index(far.replace("left_", side))
                end = joints[beyond]
            else:
                beyond = None
                mirror = -1.0 if side == "right_" else 1.0
                end = joints[joint] + torch.tensor(far) * torch.tensor([mirror, 1.0, 1.0])
            capsules.append(_Capsule(joint, beyond, joints[joint], end, radius))
    return capsules


def _unit_capsule() -> tuple[Float[Tensor, " P"], Float[Tensor, "P 3"], Int64[Tensor, "T 3"]]:
    """A capsule along +Z of unit radius: place on the axis in [0, 1], unit normals, triangles."""
    steps = [math.pi / 2 * ring / CAP_RINGS for ring in range(CAP_RINGS)]
    # Latitude and place on the axis of each ring, from the pole at 0 to the pole at 1.
    rings = [(-angle, 0.0) for angle in reversed(steps)]
    rings += [(0.0, share) for share in (BLEND, 1 - BLEND)]
    rings += [(angle, 1.0) for angle in steps]
    along, around = [0.0], [(0.0, 0.0, -1.0)]
    for latitude, place in rings:
        for segment in range(SEGMENTS):
            turn = 2 * math.pi * segment / SEGMENTS
            flat = math.cos(latitude)
            along.append(place)
            around.append((flat * math.cos(turn), flat * math.sin(turn), math.sin(latitude)))
    along.append(1.0)
    around.append((0.0, 0.0, 1.0))
    last, top = len(along) - 1, len(along) - 1 - SEGMENTS
    faces = []
    for segment in range(SEGMENTS):
        following = (segment + 1) % SEGMENTS
        faces.append((0, 1 + following, 1 + segment))
        faces.append((last, top + segment, top + following))
        for ring in range(len(rings) - 1):
            low, high = 1 + ring * SEGMENTS, 1 + (ring + 1) * SEGMENTS
            faces.append((low + segment, low + following, high + following))
            faces.append((low + segment, high + following, high + segment))
    return torch.tensor(along), torch.tensor(around), torch.tensor(faces)


def _frame(axis: Float[Tensor, " 3"]) -> Float[Tensor, "3 3"]:
    """Rows of a right-handed frame whose third is along `axis`."""
    third = axis / axis.norm()
    spare = torch.eye(3)[int(third.abs().argmin())]
    first = torch.linalg.cross(spare, third)
    first = first / first.norm()
    return torch.stack([first, torch.linalg.cross(third, first), third])


def _weights(capsule: _Capsule, along: Float[Tensor, " P"]) -> Float[Tensor, "P J"]:
    """Weights that pass linearly to the neighbouring joints towards both ends, half way at most."""
    weights = torch.zeros(len(along), len(SMPL_PARENTS))
    before = 0.5 * (1 - along / BLEND).clamp(min=0)
    after = 0.5 * (1 - (1 - along) / BLEND).clamp(min=0)
    if SMPL_PARENTS[capsule.joint] >= 0:
        weights[:, SMPL_PARENTS[capsule.joint]] += before
    if capsule.beyond is not None:
        weights[:, capsule.beyond] += after
    weights[:, capsule.joint] += 1 - weights.sum(1)
    return weights
