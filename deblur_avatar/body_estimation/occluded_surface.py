"""Occluded surface: the share of the body that the training camera never sees.

The less it sees, the more must be taken over from what it does see.
"""

import numpy as np

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed_meshes, shaped_vertices
from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.rendering.mesh_rendering import View
from deblur_avatar.rendering.visibility import seen_cells

FRAMES = 24  # at most, spread over the clip
CELLS = 1  # a triangle


def occluded_fraction(body: Body, poses: Poses, cameras: Cameras, camera: int) -> float:
    """Share of the area that is seen in no frame, in [0, 1].

    Args:
        body: whose surface.
        poses: of the frames trained on.
        cameras: without distortion.
        camera: the one that films.
    """
    some = poses.at(evenly_spaced(range(len(poses.transl)), FRAMES))
    frames = [mesh.double().numpy() for mesh in posed_meshes(body, some)]
    faces = body.faces.numpy()
    seen = seen_cells(frames, faces, View.of(cameras, camera, 1), CELLS)[:, 0, 0]
    corners = shaped_vertices(body, poses.betas).double().numpy()[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(across, axis=-1)
    return float(areas[~seen].sum() / areas.sum())
