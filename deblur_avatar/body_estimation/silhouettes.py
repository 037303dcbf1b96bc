"""Silhouette loss: how well a body fills the mattes of several cameras, in pixels.

Two distances: body points outside a matte, and points of a matte's outline that the body does not
reach. Each alone is met by a body too thin or too stout. V views, F frames, P body points, Q
outline points; a matte's inside is where it is half full or more. Distances live on a grid `SHRINK`
times coarser than the pictures and are in the pictures' pixels.
"""

from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int64, UInt8
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from torch import Tensor

SHRINK = 4  # times: outlines need no more pixels
INSIDE = 128  # of 255
OUTLINE_POINTS = 96  # a matte
SHORTEST_OUTLINE = 0.1  # share of the longest; shorter pieces are specks


class Silhouettes(NamedTuple):
    """Mattes turned into distances; `shown` is False for frames without an inside."""

    outside: Float32[Tensor, "V F h w"]  # pixels from the matte; 0 inside
    outline: Float32[Tensor, "V F Q 2"]  # pixels
    normals: Float32[Tensor, "V F Q 2"]  # unit, outwards
    shown: Bool[Tensor, "V F"]


def silhouettes(stacks: list[UInt8[Tensor, "F H W"]]) -> Silhouettes:
    """Measure the mattes of all views once, before fitting."""
    views = []
    for stack in stacks:
        frames = [_measure(matte.numpy()) for matte in stack]
        parts = zip(*frames, strict=True)
        views.append([torch.from_numpy(np.stack(part)) for part in parts])
    outside, outline, normals, shown = (torch.stack(part) for part in zip(*views, strict=True))
    return Silhouettes(outside, outline, normals, shown)


def _measure(
    matte: UInt8[np.ndarray, "H W"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    size = matte.shape[1] // SHRINK, matte.shape[0] // SHRINK
    inside = (cv2.resize(matte, size, interpolation=cv2.INTER_AREA) >= INSIDE).astype(np.uint8)
    outline, normals = np.zeros((2, OUTLINE_POINTS, 2), np.float32)
    if not inside.any():
        return np.zeros(inside.shape, np.float32), outline, normals, np.array(False)
    # Not OpenCV's: with one thread, or of a small picture, it asks Intel's IPP, which reads memory
    # that it never wrote (opencv/opencv issue 24082).
    outside = SHRINK * distance_transform_edt(1 - inside).astype(np.float32)
    full = (matte >= INSIDE).astype(np.uint8)
    found, _ = cv2.findContours(full, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    longest = max(len(piece) for piece in found)
    pieces = [piece[:, 0] for piece in found if len(piece) >= SHORTEST_OUTLINE * longest]
    points = np.concatenate(pieces)
    chosen = points[np.linspace(0, len(points) - 1, OUTLINE_POINTS).round().astype(int)]
    smooth = cv2.blur(matte.astype(np.float32), (2 * SHRINK + 1, 2 * SHRINK + 1))
    slopes = [cv2.Sobel(smooth, cv2.CV_32F, *axis) for axis in ((1, 0), (0, 1))]
    normals = -np.stack([slope[chosen[:, 1], chosen[:, 0]] for slope in slopes], axis=-1)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-6)
    return outside, chosen.astype(np.float32) + 0.5, normals, np.array(True)


def distance_outside(
    outside: Float[Tensor, "F h w"], pixels: Float[Tensor, "F P 2"]
) -> Float[Tensor, "F P"]:
    """How far projected points of one view are from the matte, pixels; differentiable."""
    height, width = outside.shape[1:]
    place = pixels / (SHRINK * pixels.new_tensor([width, height])) * 2 - 1
    sampled = torch.nn.functional.grid_sample(
        outside[:, None], place[:, :, None], padding_mode="border", align_corners=False
    )
    return sampled[:, 0, :, 0]


def nearest_points(
    outline: Float[Tensor, "F Q 2"], pixels: Float[Tensor, "F P 2"]
) -> Int64[Tensor, "F Q"]:
    """Which projected point is nearest to each outline point of one view."""
    pairs = zip(outline.numpy(), pixels.detach().numpy(), strict=True)
    return torch.stack([torch.from_numpy(cKDTree(b).query(a)[1]) for a, b in pairs])
