"""Triangulation of landmarks that several cameras see, without outliers.

Conventions. V views, F frames, L landmarks; pixels and metres; a confidence of 0 means not seen.
Detectors mistake left for right and the front for the back, in one view for many frames, so a view
is not merely noisy but wrong: what most views agree on wins.
"""

import logging
from itertools import combinations
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import project

logger = logging.getLogger(__name__)

DAMPING = 1e-9  # keeps the normal equations of a point that no two views see solvable


class Triangulated(NamedTuple):
    """Points, whether at least two views agree on them, and how far off each view is."""

    points: Float[Tensor, "F L 3"]  # metres; 0 where not found
    found: Bool[Tensor, "F L"]
    inliers: Bool[Tensor, "V F L"]
    residuals: Float[Tensor, "V F L"]  # pixels; 0 where not seen or not found


def triangulate(
    pixels: Float[Tensor, "V F L 2"],
    confidences: Float[Tensor, "V F L"],
    Ks: Float[Tensor, "V 3 3"],
    viewmats: Float[Tensor, "V 4 4"],
    tolerance: float,
) -> Triangulated:
    """Find the point that explains most views, then refine it on the views that agree.

    Every pair of views proposes a point; the one with the smallest truncated error over all views
    is kept, and solved again by least squares over the views within `tolerance` pixels of it.

    Raises:
        ValueError: for fewer than two views.
    """
    if len(pixels) < 2:
        raise ValueError(f"triangulation needs two views, got {len(pixels)}")
    pixels, confidences = pixels.double(), confidences.double()
    Ks, viewmats = Ks.double(), viewmats.double()
    best = torch.full(confidences.shape[1:], torch.inf).double()
    points = torch.zeros(*confidences.shape[1:], 3).double()
    for pair in combinations(range(len(pixels)), 2):
        weights = torch.zeros_like(confidences)
        weights[list(pair)] = confidences[list(pair)]
        proposed = _solve(pixels, weights, Ks, viewmats)
        errors = _residuals(proposed, pixels, Ks, viewmats).clamp(max=tolerance).square()
        cost = (confidences * errors).sum(0)
        usable = (weights > 0).sum(0) == 2
        better = usable & (cost < best)
        best = torch.where(better, cost, best)
        points = torch.where(better[..., None], proposed, points)
    seen = confidences > 0
    inliers = seen & (_residuals(points, pixels, Ks, viewmats) <= tolerance)
    points = _solve(pixels, confidences * inliers, Ks, viewmats)
    residuals = _residuals(points, pixels, Ks, viewmats)
    found = (inliers.sum(0) >= 2) & torch.isfinite(points).all(-1)
    return Triangulated(
        points=torch.where(found[..., None], points, 0.0).float(),
        found=found,
        inliers=inliers & found,
        residuals=torch.where(seen & found, residuals, 0.0).float(),
    )


def check_agreement(
    found: Triangulated, confidences: Float[Tensor, "V F L"], names: list[str]
) -> None:
    """Refuse views that never agree; warn of one that mostly saw something else.

    Raises:
        ArtifactError: if no two views agree on any landmark.
    """
    if not found.found.any():
        raise ArtifactError("no two cameras agree on where the person is; check the calibration")
    for name, agreed, seen in zip(names, found.inliers, confidences > 0, strict=True):
        share = float(agreed.sum() / seen.sum().clamp(min=1))
        if share < 0.5:
            logger.warning(
                "camera %s agrees with the others on %.0f %% of the landmarks; does it follow "
                "another person, or is it out of time?",
                name,
                100 * share,
            )


def _solve(
    pixels: Float[Tensor, "V F L 2"],
    weights: Float[Tensor, "V F L"],
    Ks: Float[Tensor, "V 3 3"],
    viewmats: Float[Tensor, "V 4 4"],
) -> Float[Tensor, "F L 3"]:
    """Least squares over all views: the direct linear transform with the point's fourth entry 1.

    Source: Hartley and Zisserman, "Multiple View Geometry", section 12.2 (inhomogeneous solution).
    """
    projections = Ks @ viewmats[:, :3]
    rows = pixels[..., None] * projections[:, None, None, None, 2] - projections[:, None, None, :2]
    rows = rows * weights[..., None, None]  # V F L 2 4
    system, target = rows[..., :3], -rows[..., 3]
    normal = torch.einsum("vflai,vflaj->flij", system, system)
    right = torch.einsum("vflai,vfla->fli", system, target)
    scale = normal.diagonal(dim1=-2, dim2=-1).sum(-1).clamp(min=1.0)
    normal = normal + DAMPING * scale[..., None, None] * torch.eye(3).to(normal)
    return torch.linalg.solve(normal, right)


def _residuals(
    points: Float[Tensor, "F L 3"],
    pixels: Float[Tensor, "V F L 2"],
    Ks: Float[Tensor, "V 3 3"],
    viewmats: Float[Tensor, "V 4 4"],
) -> Float[Tensor, "V F L"]:
    """Distance in pixels of each view's landmark from the projected point."""
    projected = [project(points, K, viewmat)[0] for K, viewmat in zip(Ks, viewmats, strict=True)]
    return (torch.stack(projected) - pixels).norm(dim=-1)
