"""Linear blend skinning and forward kinematics.

Conventions. `joint_transforms` are rigid 4x4 matrices from rest to posed, world-aligned at rest,
metres. `parents[j] < j`, the root's parent is -1. `lbs_weights` are non-negative and each row sums
to 1. J joints, P points.
"""

from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor


def forward_kinematics(
    rotations: Float[Tensor, "*batch J 3 3"],
    joints: Float[Tensor, "J 3"],
    transl: Float[Tensor, "*batch 3"],
    parents: tuple[int, ...],
) -> Float[Tensor, "*batch J 4 4"]:
    """Chain joint rotations into rest-to-posed transforms.

    Args:
        rotations: of each joint relative to its parent; joint 0 turns the whole body about itself.
        joints: rest positions, metres.
        transl: added to everything after posing, metres.
        parents: index of each joint's parent; a parent precedes its children.

    Returns:
        Matrices that move a rest-pose point as if glued to each joint.

    Source: Loper et al., "SMPL", SIGGRAPH Asia 2015, eq. 2-4. All joints take ever longer leaps
    towards the root at once, so the cost is the logarithm of the tree's height.
    """
    offsets = _offsets(joints, parents)
    world = _affine(rotations, offsets.expand(*rotations.shape[:-2], 3))
    still = torch.eye(4).to(world).expand(*world.shape[:-3], 1, 4, 4)
    for above in _leaps(parents):
        padded = torch.cat([world, still], dim=-3)
        world = padded.index_select(-3, above.to(world.device)) @ world
    turned = world[..., :3, :3]
    shift = world[..., :3, 3] - (turned @ joints[..., None])[..., 0] + transl[..., None, :]
    return _affine(turned, shift)


def _affine(
    rotation: Float[Tensor, "*batch 3 3"], shift: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 4 4"]:
    top = torch.cat([rotation, shift[..., None]], dim=-1)
    bottom = top.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*top.shape[:-2], 1, 4)
    return torch.cat([top, bottom], dim=-2)


def blend_transforms(
    lbs_weights: Float[Tensor, "P J"], joint_transforms: Float[Tensor, "*batch J 4 4"]
) -> Float[Tensor, "*batch P 4 4"]:
    """Average the joints' transforms for each point: linear blend skinning's matrix."""
    flat = joint_transforms.flatten(-2)
    return (lbs_weights @ flat).unflatten(-1, (4, 4))


def transform_points(
    transforms: Float[Tensor, "*batch P 4 4"], points: Float[Tensor, "*#batch P 3"]
) -> Float[Tensor, "*batch P 3"]:
    """Apply one affine transform to each point."""
    return (transforms[..., :3, :3] @ points[..., None])[..., 0] + transforms[..., :3, 3]


def skin_points(
    points: Float[Tensor, "P 3"],
    lbs_weights: Float[Tensor, "P J"],
    joint_transforms: Float[Tensor, "*batch J 4 4"],
) -> Float[Tensor, "*batch P 3"]:
    """Move rest-pose points with the body.

    Source: Loper et al., "SMPL", SIGGRAPH Asia 2015, without the blend shapes.
    """
    return transform_points(blend_transforms(lbs_weights, joint_transforms), points)


def invert_rigid(transforms: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """Invert rigid transforms without a general matrix inverse."""
    rotation = transforms[..., :3, :3].transpose(-1, -2)
    shift = -(rotation @ transforms[..., :3, 3:])
    bottom = transforms[..., 3:, :]
    return torch.cat([torch.cat([rotation, shift], dim=-1), bottom], dim=-2)


def _offsets(joints: Tensor, parents: tuple[int, ...]) -> Tensor:
    """Each joint's rest position relative to its parent's."""
    above = joints[[max(p, 0) for p in parents]]
    root = joints.new_tensor([[0.0 if p < 0 else 1.0] for p in parents])
    return joints - above * root


@lru_cache
def _leaps(parents: tuple[int, ...]) -> tuple[Tensor, ...]:
    """Each joint's ancestor 1, 2, 4, ... levels up; one past the last joint for above the root."""
    outside = len(parents)
    if any(parent >= joint for joint, parent in enumerate(parents)):
        raise ValueError(f"parents must come first, got {parents}")
    above = [outside if parent < 0 else parent for parent in parents]
    leaps = []
    while any(joint != outside for joint in above):
        leaps.append(torch.tensor(above))
        above = [outside if joint == outside else above[joint] for joint in above]
    return tuple(leaps)
