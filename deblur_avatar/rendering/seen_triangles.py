"""Seen triangles: which triangle of a mesh lies before each pixel."""

import numpy as np
from jaxtyping import Float, Int, Int32

from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.rendering.mesh_rendering import View, cast_rays


def seen_triangles(
    vertices: Float[np.ndarray, "P 3"], faces: Int[np.ndarray, "T 3"], camera: Camera
) -> Int32[np.ndarray, "H W"]:
    """Visibility of triangles: row of the first one that each pixel's middle meets; -1 for none.

    Args:
        vertices: world, metres.
        faces: rows of vertices.
        camera: without distortion.
    """
    K, viewmat = (part.double().cpu().numpy() for part in (camera.K, camera.viewmat))
    view = View(K, viewmat, camera.width, camera.height, samples_per_axis=1)
    hits = cast_rays(vertices, faces, view.centre, view.directions.reshape(-1, 3))
    return hits.triangle.reshape(camera.height, camera.width)
