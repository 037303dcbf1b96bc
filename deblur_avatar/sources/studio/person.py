"""The clothed person as a mesh that takes any pose."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from deblur_avatar.artifacts import Body
from deblur_avatar.avatar.body import joint_transforms, shaped_joints, shaped_vertices
from deblur_avatar.geometry.rotations import axis_angle_to_quat
from deblur_avatar.imaging.mesh_rendering import TexturedMesh
from deblur_avatar.sources.studio.clothes import dress
from deblur_avatar.sources.studio.drape import Drape, hang
from deblur_avatar.sources.studio.motion import Moves
from deblur_avatar.sources.studio.texture import paint


@dataclass(frozen=True)
class Person:
    """Body, clothes and colours of one person; her pose is given anew each time."""

    body: Body
    betas: Float[Tensor, " B"]
    mesh: TexturedMesh
    drape: Drape

    def posed(self, moves: Moves) -> Iterator[Float32[np.ndarray, "P 3"]]:
        """Vertices at each instant: skinned as the body, cloth hanging as the pose lets it."""
        transforms = joint_transforms(
            self.body, self.betas.double(), moves.global_orient, moves.body_pose, moves.transl
        )
        turned = torch.cat([moves.global_orient[:, None], moves.body_pose], 1)
        bends = axis_angle_to_quat(turned)[..., 1:].square().sum(-1)
        for transform, bend in zip(transforms.float().numpy(), bends.float().numpy(), strict=True):
            yield self.drape.skinned(transform, bend)


def create_person(body: Body, betas: Float[Tensor, " B"]) -> Person:
    """Shape, dress and paint a person."""
    dressed = dress(
        shaped_vertices(body, betas).double().numpy(),
        shaped_joints(body, betas).double().numpy(),
        body.lbs_weights.double().numpy(),
        body.faces.numpy(),
    )
    return Person(body, betas, TexturedMesh(dressed.faces, paint(dressed)), hang(dressed))
