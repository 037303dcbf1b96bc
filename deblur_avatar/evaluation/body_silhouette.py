"""Silhouette of one posed body in a camera's picture."""

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import distance_transform_edt

from deblur_avatar.bodies.posed_body import PosedBody
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.rendering.mesh_rendering import View, cast_rays

INSIDE = 127  # of a matte's 255: more is the person


def body_triangles(surface: PosedBody, camera: Camera) -> Int[np.ndarray, "H W"]:
    """Which triangle of a body in its first pose each pixel sees; -1 for none."""
    K, viewmat = (part.double().cpu().numpy() for part in (camera.K, camera.viewmat))
    view = View(K, viewmat, camera.width, camera.height, samples_per_axis=1)
    vertices, faces = surface.vertices[0].numpy(), surface.body.faces.numpy()
    hits = cast_rays(vertices, faces, view.centre, view.directions.reshape(-1, 3))
    return hits.triangle.reshape(camera.height, camera.width)


def silhouette_distance(surface: PosedBody, camera: Camera) -> Float[np.ndarray, "H W"]:
    """Metres, at the body's depth, from each pixel to the silhouette of a body in its first pose.

    Infinite everywhere if the body is not in the picture.
    """
    inside = body_triangles(surface, camera) >= 0
    if not inside.any():
        return np.full(inside.shape, np.inf)
    depth = float((camera.viewmat[:3, :3] @ surface.joints[0, 0] + camera.viewmat[:3, 3])[2])
    metres = depth / float(camera.K[0, 0])
    return np.asarray(distance_transform_edt(~inside) * metres)
