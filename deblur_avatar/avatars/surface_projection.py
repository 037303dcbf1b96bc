"""How far canonical Gaussians stand off the body's surface.

Conventions. Heights are metres along the surface's outward normal at the nearest vertex, negative
inside the body. N Gaussians, V vertices.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from deblur_avatar.geometry.nearest import nearest


@dataclass(frozen=True)
class SurfaceProjection:
    """Where on the surface each Gaussian stood when it was last looked up."""

    places: Float[Tensor, "N 3"]
    normals: Float[Tensor, "N 3"]  # unit

    def heights(self, means: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
        """Heights of Gaussians that have not gone far since."""
        return ((means - self.places) * self.normals).sum(-1)


def closest_points(
    means: Float[Tensor, "N 3"], vertices: Float[Tensor, "V 3"], faces: Int64[Tensor, "T 3"]
) -> SurfaceProjection:
    """Look up the vertex nearest to each Gaussian."""
    index = nearest(means, vertices).indices[:, 0]
    return SurfaceProjection(vertices[index], vertex_normals(vertices, faces)[index])


def vertex_normals(
    vertices: Float[Tensor, "V 3"], faces: Int64[Tensor, "T 3"]
) -> Float[Tensor, "V 3"]:
    """Unit normals: means over the triangles around each vertex, weighted by their area."""
    corners = vertices[faces]
    across = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    summed = torch.zeros_like(vertices).index_add_(
        0, faces.flatten(), across.repeat_interleave(3, 0)
    )
    return torch.nn.functional.normalize(summed, dim=-1)
