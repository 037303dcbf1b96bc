"""Swept mattes: how long a fast limb covered each pixel, by the body's own motion.

A detector says where a person is, and is as sure of a limb that passed as of one that stayed. The
body that was fitted frame by frame says how long it stayed: the mean of its silhouettes over the
exposure, which bounds the matte. Clothes stand out from that body, so a pixel is bounded by the
longest covered place near it; where the body never was near, the detector is left alone.
"""

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32, UInt8
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed_meshes
from deblur_avatar.imaging.exposure import mean_of_instants
from deblur_avatar.rendering.mesh_rendering import View, cast_rays

INSTANTS = 9  # of an exposure
CLOTHES = 0.02  # of the picture's height that clothes may stand out


def swept_mattes(
    mattes: UInt8[Tensor, "F H W"], clip: BlurryClip, body: Body, poses: Poses
) -> UInt8[Tensor, "F H W"]:
    """Bound mattes of the training camera by how long the body covered each pixel.

    Args:
        mattes: as detected; those of instants are left alone.
        clip: whose exposures and camera, without distortion.
        body: whose silhouettes.
        poses: one a frame; between frames they are taken to move evenly.
    """
    if not clip.exposure:
        return mattes
    view = View.of(clip.cameras, clip.train_camera, 1)
    offsets = ((torch.arange(INSTANTS) + 0.5) / INSTANTS - 0.5) * clip.exposure
    bounded = []
    for frame in run.progress(range(len(mattes)), "swept mattes"):
        instants = poses.at_times(clip.timestamps, clip.timestamps[frame] + offsets)
        seen = [_silhouette(mesh.numpy(), body, view) for mesh in posed_meshes(body, instants)]
        stack = torch.from_numpy(np.stack(seen))
        bounded.append(_bounded(mattes[frame], mean_of_instants(stack).numpy()))
    return torch.stack(bounded)


def _silhouette(
    vertices: Float[np.ndarray, "P 3"], body: Body, view: View
) -> Float32[np.ndarray, "H W"]:
    """1 where the body is; only the pixels of its box are asked."""
    picture = np.zeros((view.height, view.width), np.float32)
    pixels, _ = view.project(vertices)
    size = (view.width, view.height)
    left, top = np.clip(np.floor(pixels.min(0)), 0, size).astype(int)
    right, bottom = np.clip(np.ceil(pixels.max(0)), 0, size).astype(int)
    if right <= left or bottom <= top:
        return picture
    rays = view.directions[top:bottom, left:right]
    hits = cast_rays(vertices, body.faces.numpy(), view.centre, rays.reshape(-1, 3))
    picture[top:bottom, left:right] = (hits.triangle >= 0).reshape(rays.shape[:2])
    return picture


def _bounded(
    matte: UInt8[Tensor, "H W"], covered: Float32[np.ndarray, "H W"]
) -> UInt8[Tensor, "H W"]:
    radius = max(1, round(CLOTHES * covered.shape[0]))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    longest = cv2.dilate(covered, kernel)
    bound = np.where(longest > 0, np.rint(255 * longest), 255).astype(np.uint8)
    return torch.minimum(matte, torch.from_numpy(bound))
