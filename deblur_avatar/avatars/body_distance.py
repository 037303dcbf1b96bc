"""Signed distances from the body: what is known of a person's surface before any frame is seen.

Conventions. Metres, negative inside. A body's mesh is closed, but its parts may overlap: a point is
inside where a ray from it leaves more surfaces than it enters. P points.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from deblur_avatar.avatars.gaussians import sample_surface
from deblur_avatar.geometry.nearest import nearest
from deblur_avatar.rendering.mesh_rendering import cast_rays, face_normals

# Not parameters: what is known of the body is as fine as this, whatever learns it.
SURFACE_SAMPLES = 30_000  # of an adult, 8 mm apart
MOST_SURFACES = 32  # that a ray passes
STEP = 1e-4  # metres behind a surface that a ray goes on
DIRECTION = (0.5773, 0.2113, 0.7887)  # along no edge of a body that stands
OFF_SURFACE = 1e-3  # metres in front of a point, where it is seen whether that is outside
NEAR_STD = 0.05  # metres from the surface, of points near it
MARGIN = 0.1  # metres, of the box round the body


@dataclass(frozen=True)
class KnownDistances:
    """Points and how far they are from the body."""

    points: Float[Tensor, "P 3"]
    distances: Float[Tensor, " P"]

    def some(self, count: int, generator: torch.Generator) -> "KnownDistances":
        """Points drawn from these, with replacement."""
        chosen = torch.randint(len(self.points), (count,), generator=generator)
        chosen = chosen.to(self.points.device)
        return KnownDistances(self.points[chosen], self.distances[chosen])


def distances_all_over(
    vertices: Float[Tensor, "V 3"], faces: Int64[Tensor, "T 3"], count: int
) -> KnownDistances:
    """Distances at points spread evenly in the box round a body; the same each time."""
    generator = torch.Generator().manual_seed(0)
    low, high = vertices.amin(0) - MARGIN, vertices.amax(0) + MARGIN
    draws = torch.rand(count, 3, generator=generator, dtype=vertices.dtype).to(vertices)
    points = low + (high - low) * draws
    return KnownDistances(points, signed_distances(points, vertices, faces))


def distances_near(
    vertices: Float[Tensor, "V 3"],
    faces: Int64[Tensor, "T 3"],
    count: int,
    generator: torch.Generator,
) -> KnownDistances:
    """Distances at points off the surface, by `NEAR_STD` along each axis."""
    points, _, _ = sample_surface(vertices, faces, count, generator)
    apart = torch.randn(points.shape, generator=generator, dtype=points.dtype).to(points)
    points = points + NEAR_STD * apart
    return KnownDistances(points, signed_distances(points, vertices, faces))


def signed_distances(
    points: Float[Tensor, "P 3"], vertices: Float[Tensor, "V 3"], faces: Int64[Tensor, "T 3"]
) -> Float[Tensor, " P"]:
    """Distances from a mesh, to some millimetres: from the nearest of many points on it."""
    generator = torch.Generator().manual_seed(0)
    surface = outer_surface(vertices, faces, SURFACE_SAMPLES, generator)
    distance = nearest(points, surface).distances[:, 0].to(points)
    return torch.where(inside(points, vertices, faces), -distance, distance)


def outer_surface(
    vertices: Float[Tensor, "V 3"],
    faces: Int64[Tensor, "T 3"],
    count: int,
    generator: torch.Generator,
) -> Float[Tensor, "P 3"]:
    """Points on a mesh, of so many drawn those that no other part of it holds."""
    points, chosen, _ = sample_surface(vertices, faces, count, generator)
    corners = vertices[faces[chosen]]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    before = points + OFF_SURFACE * torch.nn.functional.normalize(normals, dim=1)
    return points[~inside(before, vertices, faces)]


def inside(
    points: Float[Tensor, "P 3"], vertices: Float[Tensor, "V 3"], faces: Int64[Tensor, "T 3"]
) -> Bool[Tensor, " P"]:
    """Which points a mesh holds."""
    mesh, triangles = vertices.detach().cpu().numpy(), faces.cpu().numpy()
    direction = np.array(DIRECTION) / np.linalg.norm(DIRECTION)
    leaving = np.sign(face_normals(mesh, triangles) @ direction).astype(int)
    surplus = np.zeros(len(points), int)
    going, origins = np.arange(len(points)), points.detach().cpu().double().numpy()
    for _ in range(MOST_SURFACES):
        hits = cast_rays(mesh, triangles, origins, np.broadcast_to(direction, origins.shape))
        met = hits.triangle >= 0
        going, origins = going[met], origins[met]
        if not len(going):
            break
        surplus[going] += leaving[hits.triangle[met]]
        origins = origins + (hits.distance[met, None].astype(float) + STEP) * direction
    return torch.as_tensor(surplus > 0, device=points.device)
