"""Closed surface: no view from any side goes through the body.

A camera that never walks round a person leaves the seam between what it sees and what it does not
to nobody: its pixels beyond the silhouette take light away there, and no pixel asks for it back.
From the side the seam is a gap through head, trunk and limbs. Here the canonical avatar is looked
at from all sides; well inside the body's silhouette it has to cover what is behind it.

Conventions. World of the canonical pose, metres.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt, maximum_filter
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.avatar import AvatarModel, TrainingStep
from deblur_avatar.bodies.triangle_joints import triangle_joints
from deblur_avatar.geometry.cameras import Camera, look_at
from deblur_avatar.rendering.seen_triangles import seen_triangles

# Not parameters: how the loss is sampled, and its weight was chosen with them.
VIEWS = 24  # directions, evenly over the sphere
STRIDE = 7  # from one to the next in order; coprime to their number
SIZE = 192  # pixels of a view
DISTANCE = 2.0  # of a camera from the body's middle, in the body's diameters
# How deep inside the silhouette nothing may be seen through, as a share of how deep it gets within
# `NEAR`: a person may be that much thinner than the body that was fitted to her.
INSIDE = 0.5
NEAR = 0.06  # metres
COVERED = 0.8  # alpha from where on a pixel is closed
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


@dataclass(frozen=True, eq=False)
class ClosureView:
    """One look at the canonical body, and the pixels that lie well inside it."""

    camera: Camera
    inside: Bool[Tensor, "H W"]
    triangles: Int[Tensor, "H W"]  # that are seen; -1 beside the body

    def __deepcopy__(self, memo: object) -> "ClosureView":
        """Itself: it never changes, and every snapshot of a fit copies the avatar."""
        return self

    def coverage(
        self,
        avatar: AvatarModel,
        rotations: Float[Tensor, "J 3 3"],
        position: int,
        step: TrainingStep | None = None,
    ) -> Float[Tensor, " inside"]:
        """Alpha of the canonical avatar on the pixels inside, differentiably.

        Args:
            avatar: of this very body.
            rotations: of the joints relative to their parents, for whose pose it is conditioned.
            position: of the exposure for which it is conditioned.
            step: of fitting, if it is being fitted.
        """
        still = unmoved(avatar)
        state = avatar.condition(rotations, position, still[0], self.camera.viewmat, step)
        return avatar.render(state, still, self.camera).alpha[0][self.inside]


def unmoved(avatar: AvatarModel) -> Float[Tensor, "1 J 4 4"]:
    """Transforms of joints that stay where they are in the canonical pose."""
    return torch.eye(4, device=avatar.betas.device).expand(1, len(avatar.body.parents), 4, 4)


def open_share(coverage: Float[Tensor, " inside"]) -> Float[Tensor, ""]:
    """By how much coverage falls short of `COVERED`, mean."""
    return (COVERED - coverage).relu().mean()


def closure_views(
    vertices: Float[Tensor, "V 3"], body: Body, nearer: Mapping[str, float]
) -> list[ClosureView]:
    """Views of a body from `VIEWS` directions of a Fibonacci sphere; neighbours in order are apart.

    Args:
        vertices: of the canonical body, its up along +Y.
        body: whose they are.
        nearer: joints whose surface has to be covered nearer to the silhouette than `INSIDE`, and
            from what share of the depth on, in [0, 1).
    """
    low, high = vertices.min(0).values, vertices.max(0).values
    middle, diameter = (low + high) / 2, float((high - low).norm())
    focal, centre = SIZE * DISTANCE, SIZE / 2
    K = vertices.new_tensor([[focal, 0.0, centre], [0.0, focal, centre], [0.0, 0.0, 1.0]])
    up = vertices.new_tensor([0.0, 1.0, 0.0])
    reach = round(NEAR * SIZE / diameter)  # pixels
    mesh = vertices.cpu().numpy(), body.faces.cpu().numpy()
    shares = _shares(body, nearer)
    views = []
    for step in range(VIEWS):
        eye = middle + DISTANCE * diameter * vertices.new_tensor(_direction(step * STRIDE % VIEWS))
        camera = Camera(K, look_at(eye, middle, up), SIZE, SIZE)
        triangles = seen_triangles(*mesh, camera)
        depth = distance_transform_edt(triangles >= 0)  # pixels
        deepest = maximum_filter(depth, 2 * reach + 1)
        inside = (depth > 1) & (depth > shares[triangles] * deepest)
        views.append(
            ClosureView(
                camera,
                torch.from_numpy(inside).to(vertices.device),
                torch.from_numpy(triangles).to(vertices.device),
            )
        )
    return views


def _shares(body: Body, nearer: Mapping[str, float]) -> Float[np.ndarray, " T"]:
    """From what share of the depth on each triangle has to be covered."""
    joints = triangle_joints(body).cpu().numpy()
    shares = np.full(len(joints), INSIDE)
    for name, share in nearer.items():
        shares[joints == body.joint_names.index(name)] = share
    return shares


def _direction(index: int) -> list[float]:
    """A unit vector of the Fibonacci sphere, from its top to its bottom; never quite along +-Y."""
    height = 1 - (2 * index + 1) / VIEWS
    radius, angle = math.sqrt(1 - height**2), GOLDEN_ANGLE * index
    return [radius * math.cos(angle), height, radius * math.sin(angle)]
