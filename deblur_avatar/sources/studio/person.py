"""Clothed person: a mesh that takes any pose."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.posed_body import (
    joint_transforms,
    shaped_joints,
    shaped_vertices,
)
from deblur_avatar.geometry.rotations import axis_angle_to_quat
from deblur_avatar.rendering.mesh_rendering import (
    TexturedMesh,
    cell_middles,
    used_cells,
)
from deblur_avatar.rendering.visibility import openness
from deblur_avatar.sources.studio.clothes import Clothed, clothe
from deblur_avatar.sources.studio.drape import Drape, hang
from deblur_avatar.sources.studio.motion import Moves
from deblur_avatar.sources.studio.texture import CELLS, LookParams, paint

SKY_RAYS = 48  # a vertex, for the shade in its hollows
DARKEST = 0.35  # what is left of the light at the bottom of a hollow


@dataclass(frozen=True)
class Person:
    """Body, clothes and colours of one person."""

    body: Body
    betas: Float[Tensor, " B"]
    mesh: TexturedMesh
    drape: Drape

    def posed(self, moves: Moves) -> Iterator[Float32[np.ndarray, "P 3"]]:
        """Vertices at each instant: skinned with the body, the cloth as the pose lets it hang."""
        transforms = joint_transforms(
            self.body, self.betas.double(), moves.global_orient, moves.body_pose, moves.transl
        )
        bends = axis_angle_to_quat(moves.axis_angle)[..., 1:].square().sum(-1)
        swings = [None] * len(bends) if moves.swing is None else moves.swing.float().numpy()
        posed = zip(transforms.float().numpy(), bends.float().numpy(), swings, strict=True)
        for transform, bend, swung in posed:
            yield self.drape.skinned(transform, bend, swung)


def create_person(body: Body, betas: Float[Tensor, " B"], look: LookParams | None = None) -> Person:
    """Shape, clothe and paint a person; hollows are darkened once, in the rest pose."""
    clothed = clothe(
        shaped_vertices(body, betas).double().numpy(),
        shaped_joints(body, betas).double().numpy(),
        body.lbs_weights.double().numpy(),
        body.faces.numpy(),
    )
    albedo = paint(clothed, look) * _shade(clothed)[..., None]
    return Person(
        body, betas, TexturedMesh(clothed.surface.faces.astype(np.int32), albedo), hang(clothed)
    )


def _shade(clothed: Clothed) -> Float32[np.ndarray, "T R R"]:
    """The share of light that reaches each cell, from its corners."""
    surface, (u, v) = clothed.surface, cell_middles(CELLS)
    light = openness(surface.vertices, surface.normals, surface.faces, SKY_RAYS)
    a, b, c = (DARKEST + (1 - DARKEST) * light)[surface.faces].T
    table = np.zeros((len(surface.faces), CELLS, CELLS), np.float32)
    table[:, *used_cells(CELLS)] = a[:, None] + np.outer(b - a, u) + np.outer(c - a, v)
    return table
