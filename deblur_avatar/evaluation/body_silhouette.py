"""Silhouette of one posed body in a camera's picture."""

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import distance_transform_edt

from deblur_avatar.bodies.posed_body import PosedBody
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.rendering.seen_triangles import seen_triangles

INSIDE = 127  # of a matte's 255: more is the person


def body_triangles(surface: PosedBody, camera: Camera) -> Int[np.ndarray, "H W"]:
    """Which triangle of a body in its first pose each pixel sees; -1 for none."""
    return seen_triangles(surface.vertices[0].numpy(), surface.body.faces.numpy(), camera)


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
