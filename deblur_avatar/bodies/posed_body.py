"""Posing: vertices and joints of a `Body` as functions of shape and pose.

Conventions. SMPL's: `betas` shape, `global_orient` turns the body about its pelvis, `body_pose`
turns each further joint relative to its parent, `transl` moves it last. Axis-angle, radians,
metres.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import forward_kinematics, skin_points

# Joints whose chain opens the legs in the "Vitruvian" canonical pose (3DGS-Avatar's choice).
LEFT_LEG, RIGHT_LEG = 1, 2
VITRUVIAN_ANGLE = torch.pi / 4  # of each leg from the vertical


@dataclass(frozen=True)
class PosedBody:
    """A body in some poses, with the shape that these bring along."""

    body: Body
    poses: Poses

    @property
    def joints(self) -> Float[Tensor, "F J 3"]:
        """Positions of the joints in the world, metres."""
        return posed_joints(self.body, *self._motion)

    @property
    def vertices(self) -> Float[Tensor, "F P 3"]:
        """Positions of the vertices, of all poses at once; `posed_meshes` spares memory."""
        return posed_vertices(self.body, *self._motion)

    @property
    def _motion(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        poses = self.poses
        return poses.betas, poses.global_orient, poses.body_pose, poses.transl


def posed(body: Body, poses: Poses) -> PosedBody:
    """Pose a body."""
    return PosedBody(body, poses)


def shaped_joints(body: Body, betas: Float[Tensor, " B"]) -> Float[Tensor, "J 3"]:
    """Rest positions of the joints of a body of this shape."""
    return body.joints.to(betas) + body.joint_dirs.to(betas) @ betas


def shaped_vertices(body: Body, betas: Float[Tensor, " B"]) -> Float[Tensor, "P 3"]:
    """Rest positions of the vertices of a body of this shape, without pose blend shapes."""
    return body.vertices.to(betas) + body.shape_dirs.to(betas) @ betas


def joint_transforms(
    body: Body,
    betas: Float[Tensor, " B"],
    global_orient: Float[Tensor, "*batch 3"],
    body_pose: Float[Tensor, "*batch K 3"],
    transl: Float[Tensor, "*batch 3"],
) -> Float[Tensor, "*batch J 4 4"]:
    """Rest-to-posed transforms of all joints."""
    axis_angle = torch.cat([global_orient[..., None, :], body_pose], dim=-2)
    return transforms_from_rotations(body, betas, axis_angle_to_matrix(axis_angle), transl)


def transforms_from_rotations(
    body: Body,
    betas: Float[Tensor, " B"],
    rotations: Float[Tensor, "*batch J 3 3"],
    transl: Float[Tensor, "*batch 3"],
) -> Float[Tensor, "*batch J 4 4"]:
    """Rest-to-posed transforms from each joint's rotation relative to its parent."""
    return forward_kinematics(rotations, shaped_joints(body, betas), transl, body.parents)


def posed_vertices(
    body: Body,
    betas: Float[Tensor, " B"],
    global_orient: Float[Tensor, "*batch 3"],
    body_pose: Float[Tensor, "*batch K 3"],
    transl: Float[Tensor, "*batch 3"],
) -> Float[Tensor, "*batch P 3"]:
    """Vertices of the posed body, with pose blend shapes where the body has them."""
    transforms = joint_transforms(body, betas, global_orient, body_pose, transl)
    vertices = shaped_vertices(body, betas)
    weights = body.lbs_weights.to(betas)
    if body.pose_dirs is None:
        return skin_points(vertices, weights, transforms)
    feature = (axis_angle_to_matrix(body_pose) - torch.eye(3).to(betas)).flatten(-3)
    offsets = torch.einsum("vcd,...d->...vc", body.pose_dirs.to(betas), feature)
    rotation = torch.einsum("vj,...jrc->...vrc", weights, transforms[..., :3, :])
    points = vertices + offsets
    return (rotation[..., :3] @ points[..., None])[..., 0] + rotation[..., 3]


def posed_meshes(body: Body, poses: Poses) -> Iterator[Float[Tensor, "P 3"]]:
    """Vertices of the posed body, frame by frame: pose blend shapes of many would fill memory."""
    for index in range(len(poses.transl)):
        yield posed(body, poses.at([index])).vertices[0]


def posed_joints(
    body: Body,
    betas: Float[Tensor, " B"],
    global_orient: Float[Tensor, "*batch 3"],
    body_pose: Float[Tensor, "*batch K 3"],
    transl: Float[Tensor, "*batch 3"],
) -> Float[Tensor, "*batch J 3"]:
    """Positions of the joints of the posed body."""
    axis_angle = torch.cat([global_orient[..., None, :], body_pose], dim=-2)
    return joints_from_rotations(body, betas, axis_angle_to_matrix(axis_angle), transl)


def joints_from_rotations(
    body: Body,
    betas: Float[Tensor, " B"],
    rotations: Float[Tensor, "*batch J 3 3"],
    transl: Float[Tensor, "*batch 3"],
) -> Float[Tensor, "*batch J 3"]:
    """Positions of the joints from each joint's rotation relative to its parent."""
    transforms = transforms_from_rotations(body, betas, rotations, transl)
    rest = shaped_joints(body, betas)
    return (transforms[..., :3, :3] @ rest[..., None])[..., 0] + transforms[..., :3, 3]


def vitruvian_transforms(body: Body, betas: Float[Tensor, " B"]) -> Float[Tensor, "J 4 4"]:
    """Rest-to-canonical transforms: the T-pose with both legs opened by 45 degrees.

    Source: 3DGS-Avatar's canonical pose; legs apart keep the skinning of the thighs apart.
    """
    pose = betas.new_zeros(len(body.parents) - 1, 3)
    pose[LEFT_LEG - 1, 2] = VITRUVIAN_ANGLE
    pose[RIGHT_LEG - 1, 2] = -VITRUVIAN_ANGLE
    still = betas.new_zeros(3)
    return joint_transforms(body, betas, still, pose, still)
