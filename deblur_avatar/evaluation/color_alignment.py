"""Colour alignment: scores of renders after one affine map of colours for each test camera.

Cameras of a rig differ in white balance and exposure, which no avatar fitted to one of them can
know. The map of a camera is fitted, for each avatar, by least squares to that camera's own person
pixels: color' = A color + alpha b, so that what the avatar does not cover stays black.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.evaluation.comparisons import Comparison
from deblur_avatar.evaluation.metrics import METRICS, ImagePair

ALIGNED = ("psnr", "ssim", "psnr_foreground", "psnr_seen", "ssim_seen")  # metrics of interest


def color_aligned(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """The same test views, scored after each camera's colours were aligned."""
    cameras = sorted({comparison.view.camera for comparison in comparisons})
    maps = {
        camera: affine_map([c for c in comparisons if c.view.camera == camera])
        for camera in cameras
    }
    return [_aligned(comparison, maps[comparison.view.camera]) for comparison in comparisons]


def affine_map(comparisons: Sequence[Comparison]) -> Float[Tensor, "4 3"]:
    """The least-squares map from premultiplied colours and coverage to true colours.

    The identity where a camera shows no pixel of the person.
    """
    sources = torch.cat([_colors(c)[c.view.foreground] for c in comparisons])
    targets = torch.cat([c.view.image[c.view.foreground] for c in comparisons]).double() / 255
    if len(sources) == 0:
        return torch.eye(4, 3, dtype=torch.float64)
    return torch.linalg.lstsq(sources, targets, driver="gelsd").solution


def _colors(comparison: Comparison) -> Float[Tensor, "H W 4"]:
    render = comparison.render.double() / 255
    return torch.cat([render, comparison.alpha[..., None].double()], -1)


def _aligned(comparison: Comparison, mapping: Float[Tensor, "4 3"]) -> Comparison:
    view, render = comparison.view, (_colors(comparison) @ mapping).clamp(0, 1).float()
    pair = ImagePair(
        render=render[None],
        truth=view.image[None].float() / 255,
        foreground=view.foreground[None],
        seen=view.seen[None],
    )
    scores = {row.name: float(row.function(pair)) for row in METRICS if row.name in ALIGNED}
    shown = (render * 255).round().to(torch.uint8)
    return replace(comparison, render=shown, scores=scores)
