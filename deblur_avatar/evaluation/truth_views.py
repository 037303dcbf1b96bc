"""Ground-truth test views, and masks of the pixels that count in each.

Conventions. The truth is brought to the pixels of the observations: the same crops, the same scale.
`foreground` is where the true matte exceeds one half; `seen` is the part of it whose surface the
training camera saw in some training frame, since no method can know an unseen back.
"""

import logging
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.bodies.posed_body import posed_meshes
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.body_silhouette import INSIDE
from deblur_avatar.imaging.resampling import Crop, crop_and_scale
from deblur_avatar.rendering.mesh_rendering import View
from deblur_avatar.rendering.visibility import seen_cells, seen_pixels

logger = logging.getLogger(__name__)

SEEN_CELLS = 2  # along a triangle's edge of the body, whose triangles are about a pixel wide
RAYS_PER_AXIS = 2  # of a pixel


@dataclass(frozen=True, eq=False)
class TruthView:
    """One sharp picture of a test camera."""

    camera: int
    position: int  # in the observations
    novel_pose: bool  # the instant was kept from training
    image: UInt8[Tensor, "H W 3"]
    foreground: Bool[Tensor, "H W"]
    seen: Bool[Tensor, "H W"]
    viewmat: Float[Tensor, "4 4"] | None = None  # relative to the true motion; None: the camera's
    offset: float = 0.0  # seconds from the middle of the frame's exposure


def truth_views(observations: Observations, reference: Reference) -> list[TruthView]:
    """Choose and prepare the pictures that can be compared with.

    Novel views are of frames trained on, from other cameras; novel poses are of the part of the
    clip kept from training. Pictures of other frames (validation, frames whose exposure reaches
    into the part kept, frames without a person or without a blurred counterpart) are left out.

    Returns:
        Nothing for footage that has no truth.

    Raises:
        ArtifactError: if there are pictures but none is left, or the reference is of other cameras.
    """
    if not len(reference.images):
        logger.info("no sharp truth: only how well the blurred frames are explained is measured")
        return []
    if int(reference.camera_indices.max()) >= len(observations.cameras.Ks):
        raise ArtifactError(
            f"the reference shows camera {int(reference.camera_indices.max())}, the observations "
            f"know {len(observations.cameras.Ks)}; run `dvc repro`"
        )
    chosen = []
    for view in range(len(reference.images)):
        position = _position(observations, int(reference.frame_indices[view]))
        novel_pose = bool(reference.novel_pose[view])
        if position is not None and (novel_pose or position in observations.train):
            chosen.append((view, position, novel_pose))
    if not any(not novel_pose for _, _, novel_pose in chosen):
        raise ArtifactError(
            "no test view shows a training frame; lower clip.test_stride or take more frames"
        )
    skipped = len(reference.images) - len(chosen)
    logger.info("%d test views, %d of frames not trained on left out", len(chosen), skipped)
    seen = _seen_masks(observations, reference, chosen)
    return [
        _prepare(observations, reference, view, position, novel_pose, mask)
        for (view, position, novel_pose), mask in zip(chosen, seen, strict=True)
    ]


def _position(observations: Observations, frame: int) -> int | None:
    """Where a frame of the clip is in the observations, if it is there and shows a person."""
    if frame not in observations.frame_indices:
        return None
    position = observations.frame_indices.index(frame)
    return position if observations.weights[position] > 0 else None


def _prepare(
    observations: Observations,
    reference: Reference,
    view: int,
    position: int,
    novel_pose: bool,
    seen: Bool[Tensor, "H W"],
) -> TruthView:
    camera = int(reference.camera_indices[view])
    foreground = cut_as_observed(observations, camera, reference.mattes[view]) > INSIDE
    return TruthView(
        camera=camera,
        position=position,
        novel_pose=novel_pose,
        viewmat=None if reference.viewmats is None else reference.viewmats[view],
        offset=0.0 if reference.offsets is None else float(reference.offsets[view]),
        image=cut_as_observed(observations, camera, reference.images[view]),
        foreground=foreground,
        seen=seen & foreground,
    )


def cut_as_observed(
    observations: Observations, camera: int, image: UInt8[Tensor, "h w *channels"]
) -> UInt8[Tensor, "H W *channels"]:
    """A picture of one camera of the clip, in the pixels of the observations."""
    x, y, width, height = (round(float(value)) for value in observations.crops[camera])
    crop: Crop = (x, y, width, height)
    return crop_and_scale(image[None], crop, size_of(observations, camera))[0]


def size_of(observations: Observations, camera: int) -> tuple[int, int]:
    """Width and height of a camera's pictures, pixels."""
    width, height = observations.cameras.sizes[camera].tolist()
    return width, height


def _seen_masks(
    observations: Observations, reference: Reference, chosen: list[tuple[int, int, bool]]
) -> list[Bool[Tensor, "H W"]]:
    """As the source knows it, or else from the body that `preprocess` fitted.

    Hair and clothes stand out from that body: beside it the nearest of its pixels decides.
    """
    shown = reference.camera_indices.tolist()
    if reference.seen is not None:
        return [
            cut_as_observed(observations, shown[v], reference.seen[v]) > INSIDE
            for v, _, _ in chosen
        ]
    faces = observations.body.faces.numpy()
    vertices = [mesh.numpy() for mesh in posed_meshes(observations.body, observations.poses)]
    cameras = observations.cameras
    training = [vertices[position] for position in observations.train]
    filmed = View.of(cameras, observations.train_camera, RAYS_PER_AXIS)
    cells = seen_cells(training, faces, filmed, SEEN_CELLS)
    masks = []
    for view, position, _ in run.progress(chosen, "seen surface"):
        camera = View.of(cameras, shown[view], RAYS_PER_AXIS)
        body = seen_pixels(vertices[position], faces, camera, np.ones_like(cells))
        masks.append(_extend_outside(seen_pixels(vertices[position], faces, camera, cells), body))
    return masks


def _extend_outside(
    seen: Bool[np.ndarray, "H W"], body: Bool[np.ndarray, "H W"]
) -> Bool[Tensor, "H W"]:
    """Give every pixel the value of the nearest pixel of the body."""
    if not body.any():
        return torch.from_numpy(seen)
    _, labels = cv2.distanceTransformWithLabels(
        (~body).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE, labelType=cv2.DIST_LABEL_PIXEL
    )
    value_of_label = np.zeros(int(labels.max()) + 1, bool)
    value_of_label[labels[body]] = seen[body]
    return torch.from_numpy(value_of_label[labels])
