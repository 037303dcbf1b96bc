"""Visibility and ambient occlusion: which parts of a moving surface a camera has seen.

Conventions. Those of `imaging.mesh_rendering`: T triangles of R x R cells each, P vertices, metres.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float, Int

from deblur_avatar.rendering.mesh_rendering import (
    View,
    cast_rays,
    cell_middles,
    face_normals,
    unit,
    used_cells,
)

SAME_SURFACE = 1e-3  # metres; what lies this little behind the first hit still counts as seen
GRAZING = 0.1  # cosine; a surface seen flatter than 84 degrees shows nothing of itself
NEAR = 0.5  # metres; what is farther away takes no sky from a point


def seen_cells(
    frames: Iterable[Float[np.ndarray, "P 3"]],
    faces: Int[np.ndarray, "T 3"],
    view: View,
    cells: int,
) -> Bool[np.ndarray, "T R R"]:
    """Find what one camera saw of a surface in any of several frames.

    A cell is seen if its middle lies inside the image, is the first thing on its ray, and its
    outside faces the camera more than `GRAZING`.

    Args:
        frames: posed vertices.
        faces: of all frames.
        view: the camera; its samples play no part.
        cells: R.
    """
    u, v = cell_middles(cells)
    seen = np.zeros((len(faces), len(u)), bool)
    for vertices in frames:
        a, b, c = (vertices[faces[:, corner]] for corner in range(3))
        points = a[:, None] + u[:, None] * (b - a)[:, None] + v[:, None] * (c - a)[:, None]
        towards = points - view.centre
        distance = np.linalg.norm(towards, axis=-1)
        towards /= np.maximum(distance, 1e-9)[..., None]
        cosine = -(towards * unit(face_normals(vertices, faces))[:, None]).sum(-1)
        pixels, depth = view.project(points)
        inside = ((pixels >= 0) & (pixels < (view.width, view.height))).all(-1) & (depth > 0)
        asked = inside & (cosine > GRAZING) & ~seen
        hits = cast_rays(vertices, faces, view.centre, towards[asked])
        seen[asked] = hits.distance >= distance[asked] - SAME_SURFACE
    table = np.zeros((len(faces), cells, cells), bool)
    table[:, *used_cells(cells)] = seen
    return table


def seen_pixels(
    vertices: Float[np.ndarray, "P 3"],
    faces: Int[np.ndarray, "T 3"],
    view: View,
    seen: Bool[np.ndarray, "T R R"],
) -> Bool[np.ndarray, "H W"]:
    """Map what was seen into another view: the majority of a pixel's rays that meet the surface."""
    hits = cast_rays(vertices, faces, view.centre, view.directions.reshape(-1, 3))
    met = hits.triangle >= 0
    known = met & seen[np.maximum(hits.triangle, 0), *hits.cell(seen.shape[1])]
    samples = view.samples_per_axis
    rays = np.stack([met, known], -1).reshape(view.height, samples, view.width, samples, 2)
    votes = rays.sum((1, 3))
    return (votes[..., 0] > 0) & (2 * votes[..., 1] >= votes[..., 0])


def openness(
    vertices: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    faces: Int[np.ndarray, "T 3"],
    rays: int,
) -> Float[np.ndarray, " P"]:
    """How much of the light from all around reaches each vertex past the surface itself, in [0, 1].

    Args:
        vertices: of the surface.
        normals: unit, outward.
        faces: of the surface.
        rays: directions tried at each vertex, spread evenly; weighted by their cosine.
    """
    index = np.arange(2 * rays) + 0.5  # a Fibonacci sphere, of which one half faces outwards
    height, angle = 1 - index / rays, np.pi * (1 + 5**0.5) * index
    flat = np.sqrt(1 - height**2)
    sphere = np.stack([flat * np.cos(angle), height, flat * np.sin(angle)], -1)
    cosine = normals @ sphere.T
    outward = cosine > 0.05
    rows, columns = np.nonzero(outward)
    starts = vertices[rows] + SAME_SURFACE * normals[rows]
    hits = cast_rays(vertices, faces, starts, sphere[columns])
    free = np.zeros(outward.shape)
    free[outward] = np.clip(hits.distance / NEAR, 0, 1)
    weights = np.where(outward, cosine, 0)
    return (weights * free).sum(1) / weights.sum(1)
