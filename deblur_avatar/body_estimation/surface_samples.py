"""Stratified samples of a body's surface: a fixed set of points, spread by area.

Nothing is drawn at random, so a fit that uses them is the same each time. They are stored at rest,
with all that moves them.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import Body


@dataclass(frozen=True)
class SurfaceSamples:
    """Points spread evenly over the body at rest."""

    points: Float[Tensor, "P 3"]  # metres
    shape_dirs: Float[Tensor, "P 3 B"]
    lbs_weights: Float[Tensor, "P J"]


def sample_evenly(body: Body, count: int) -> SurfaceSamples:
    """Cut the surface into pieces of equal area; take the middle of the triangle each begins in."""
    corners = body.vertices[body.faces]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    share = normals.double().norm(dim=-1).cumsum(0)
    steps = (torch.arange(count) + 0.5) / count
    faces = body.faces[torch.searchsorted(share / share[-1], steps.double())]
    return SurfaceSamples(
        points=body.vertices[faces].mean(1),
        shape_dirs=body.shape_dirs[faces].mean(1),
        lbs_weights=body.lbs_weights[faces].mean(1),
    )
