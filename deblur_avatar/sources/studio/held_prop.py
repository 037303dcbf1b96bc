"""Held prop: a racket that goes with the right hand and is none of the person.

Conventions. Rest pose, metres. P vertices, T triangles, R cells along a triangle's edge.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32, Int

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.config.section import Params, Positive
from deblur_avatar.rendering.mesh_rendering import TexturedMesh
from deblur_avatar.sources.studio.texture import CELLS

HAND = SMPL_JOINT_NAMES.index("right_hand")
RADIUS, SHAFT, THICKNESS = 0.13, 0.3, 0.015  # shares of the length; metres
SIDES = 24  # of the head's polygon
FRAME, STRINGS = (0.75, 0.05, 0.35), (0.7, 0.72, 0.3)  # linear light


class HeldPropParams(Params):
    """A racket in the right hand."""

    length_m: Positive


@dataclass(frozen=True)
class HeldProp:
    """A rigid mesh, at rest where the resting hand holds it."""

    vertices: Float32[np.ndarray, "P 3"]
    mesh: TexturedMesh

    def placed(self, joint_transforms: Float[np.ndarray, "J 4 4"]) -> Float32[np.ndarray, "P 3"]:
        """Where it is when joints are so, rest to posed."""
        hand = joint_transforms[HAND]
        return (self.vertices @ hand[:3, :3].T + hand[:3, 3]).astype(np.float32)


def create_prop(body: Body, betas: Float[torch.Tensor, " B"], params: HeldPropParams) -> HeldProp:
    """A shaft and a round head, pointing forward out of a resting hand."""
    hand = shaped_joints(body, betas)[HAND].double().numpy()
    length = params.length_m
    shaft = _box((-THICKNESS, -THICKNESS, 0.0), (THICKNESS, THICKNESS, (1 - 2 * RADIUS) * length))
    angle = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)
    rim = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], -1) * RADIUS * length
    rim[:, 2] += (1 - RADIUS) * length
    middle = [[0, 0, (1 - RADIUS) * length]]
    head = np.concatenate([rim + (0, side * THICKNESS / 3, 0) for side in (-1, 1)])
    head = np.concatenate([head, middle, middle])
    faces = np.concatenate([shaft[1], _disc() + len(shaft[0])])
    colours = np.where(np.arange(len(faces))[:, None] < len(shaft[1]), FRAME, STRINGS)
    albedo = np.broadcast_to(colours[:, None, None], (len(faces), CELLS, CELLS, 3))
    vertices = np.concatenate([shaft[0], head]) + hand
    return HeldProp(
        vertices.astype(np.float32),
        TexturedMesh(faces.astype(np.int32), np.ascontiguousarray(albedo, np.float32)),
    )


def joined(first: TexturedMesh, second: TexturedMesh, vertices: int) -> TexturedMesh:
    """Two meshes as one; `vertices` are the first one's."""
    return TexturedMesh(
        np.concatenate([first.faces, second.faces + np.int32(vertices)]),
        np.concatenate([first.albedo, second.albedo]),
    )


def _disc() -> Int[np.ndarray, "T 3"]:
    """Both sides of the head and the band between them; its two middles come last."""
    here = np.arange(SIDES)
    there = (here + 1) % SIDES
    low, high = np.full(SIDES, 2 * SIDES), np.full(SIDES, 2 * SIDES + 1)
    return np.concatenate(
        [
            np.stack([low, here, there], 1),
            np.stack([high, there + SIDES, here + SIDES], 1),
            np.stack([here, here + SIDES, there], 1),
            np.stack([there, here + SIDES, there + SIDES], 1),
        ]
    )


def _box(
    low: tuple[float, float, float], high: tuple[float, float, float]
) -> tuple[Float[np.ndarray, "8 3"], Int[np.ndarray, "12 3"]]:
    corners = np.array([[(low, high)[bit >> axis & 1][axis] for axis in range(3)]
                        for bit in range(8)])  # fmt: skip
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return corners, np.array(faces)
