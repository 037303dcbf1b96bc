"""Joints that move, surfaces that follow.

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

    Source: Loper et al., "SMPL", SIGGRAPH Asia 2015, eq. 2-4. Joints of equal depth in the tree are
    computed together, so the cost is that of the tree's height.
    """
    turned: list[Tensor] = []  # per level: world rotation of its joints
    placed: list[Tensor] = []  # per level: world position of its joints
    offsets = _offsets(joints, parents)
    order, inverse, rows = _levels(parents)
    for level, members in enumerate(order):
        local = rotations[..., members, :, :]
        if level == 0:
            turned.append(local)
            placed.append(offsets[members].expand(*local.shape[:-2], 3))
            continue
        above = turned[-1][..., rows[level], :, :]
        turned.append(above @ local)
        moved = (above @ offsets[members][..., None])[..., 0]
        placed.append(placed[-1][..., rows[level], :] + moved)
    world = torch.cat(turned, dim=-3)[..., inverse, :, :]
    position = torch.cat(placed, dim=-2)[..., inverse, :]
    shift = position - (world @ joints[..., None])[..., 0] + transl[..., None, :]
    top = torch.cat([world, shift[..., None]], dim=-1)
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
def _levels(
    parents: tuple[int, ...],
) -> tuple[list[list[int]], list[int], list[list[int]]]:
    """Group joints by depth: members of each level, where each joint ends up, parents' rows."""
    depth: list[int] = []
    for joint, parent in enumerate(parents):
        if parent >= joint:
            raise ValueError(f"joint {joint} has parent {parent}: parents must come first")
        depth.append(0 if parent < 0 else depth[parent] + 1)
    order = [[j for j, d in enumerate(depth) if d == level] for level in range(max(depth) + 1)]
    rows: list[list[int]] = [[]] + [
        [order[level - 1].index(parents[j]) for j in order[level]] for level in range(1, len(order))
    ]
    flat = [j for members in order for j in members]
    inverse = [flat.index(j) for j in range(len(parents))]
    return order, inverse, rows
