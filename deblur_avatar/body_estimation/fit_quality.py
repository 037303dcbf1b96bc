"""Fit residuals: how well a fitted body explains what each camera saw of it."""

from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.body_estimation.body_fit import OUTLIER_SHARE, BodyFit
from deblur_avatar.rendering.mesh_rendering import View, cast_rays

INSIDE = 128  # matte, of 255
SHRINK = 2  # silhouettes are compared at this share of the pictures' size
EVERY = 6  # frames


def measure_fit(
    fit: BodyFit,
    body: Body,
    cameras: Cameras,
    recorded: tuple[int, ...],
    mattes: list[UInt8[Tensor, "F H W"]],
) -> dict[str, Any]:
    """Measure landmarks and silhouettes, camera by camera.

    Args:
        fit: of this body.
        body: whose surface is compared with the mattes, naked as it is.
        cameras: without distortion.
        recorded: the camera of each stack of mattes.
        mattes: of the frames that were fitted.

    Returns:
        By camera: `reprojection_px`, the median distance of landmarks, and the share of them that
        `agree` with the body, not being mistaken for others; `iou`, the overlap of matte
        and silhouette, mean over every `EVERY`-th frame with a person; and `offset_px`, how far
        right of and below the body the mattes lie in the median: where cameras differ in it by
        several pixels, `principal_point_shifts` of the scene can take it away.
    """
    poses = fit.poses
    vertices = posed(body, poses.at(slice(None, None, EVERY))).vertices.numpy()
    report = {}
    for row, camera in enumerate(recorded):
        seen = fit.residuals[row][fit.residuals[row] > 0]
        overlaps, offsets = [], []
        view = _coarse_view(cameras, camera)
        for points, matte in zip(vertices, mattes[row][::EVERY], strict=True):
            silhouette = _silhouette(points, body.faces.numpy(), view)
            size = (view.width, view.height)
            inside = cv2.resize(matte.numpy(), size, interpolation=cv2.INTER_AREA) >= INSIDE
            if inside.any() and silhouette.any():
                overlaps.append((silhouette & inside).sum() / (silhouette | inside).sum())
                offsets.append(SHRINK * (_centroid(inside) - _centroid(silhouette)))
        report[cameras.names[camera]] = {
            "reprojection_px": float(seen.median()) if len(seen) else None,
            "agree": float((seen < OUTLIER_SHARE * fit.extent).float().mean())
            if len(seen)
            else None,
            "iou": float(np.mean(overlaps)) if overlaps else None,
            "offset_px": np.median(offsets, axis=0).tolist() if offsets else None,
        }
    return report


def _coarse_view(cameras: Cameras, index: int) -> View:
    full = View.of(cameras, index, samples_per_axis=1)
    K = np.diag([1 / SHRINK, 1 / SHRINK, 1.0]) @ full.K
    return View(K, full.viewmat, full.width // SHRINK, full.height // SHRINK, 1)


def _silhouette(vertices: np.ndarray, faces: np.ndarray, view: View) -> Bool[np.ndarray, "H W"]:
    hits = cast_rays(vertices, faces, view.centre, view.directions.reshape(-1, 3))
    return (hits.triangle >= 0).reshape(view.height, view.width)


def _centroid(inside: Bool[np.ndarray, "H W"]) -> np.ndarray:
    """Mean x and y of a mask, pixels."""
    rows, columns = np.nonzero(inside)
    return np.array([columns.mean(), rows.mean()])
