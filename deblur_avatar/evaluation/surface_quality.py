"""Surface quality of a fitted avatar: fur, holes, needles, fog.

Conventions. Shares of light are of the avatar's coverage on a turntable (`avatar_measures`), which
shows it from sides that no camera saw. Shares of Gaussians are weighted by opacity.
"""

from collections.abc import Sequence

import numpy as np
import torch
from scipy.ndimage import binary_erosion

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.evaluation.avatar_measures import Look, turntable

CLOTHES = 0.05  # metres that most clothes stand off the body; light beyond it is fur
RIM = 2  # pixels inside the body's silhouette in which half a pixel's pose error leaves gaps
NEEDLE = 5.0  # times as long as wide
OPACITY_BINS = 10  # equal parts of [0, 1]


def surface_quality(
    model: AvatarModel, observations: Observations, motion: Motion
) -> dict[str, float | list[float] | None]:
    """Measure what pictures of the training camera do not show.

    Args:
        model: fitted.
        observations: of whose training frames the turntable takes poses.
        motion: fitted.

    Returns:
        `fur_share` of the coverage beyond the clothes; `holes_share` of the body's silhouette that
        is not covered; `needle_share` of the opacity, and `opacity_histogram`, shares of the
        Gaussians in ten equal bins from 0 to 1: None of an avatar that has no Gaussians.
    """
    looks = turntable(model, observations, motion)
    return {
        "fur_share": fur_share(looks),
        "holes_share": _holes_share(looks),
        "needle_share": _needle_share(model),
        "opacity_histogram": _opacity_histogram(model),
    }


def fur_share(looks: Sequence[Look]) -> float | None:
    """Share of the coverage beyond the clothes; None where nothing is covered."""
    total = sum(float(look.alpha.sum()) for look in looks)
    beyond = sum(
        float(look.alpha[torch.from_numpy(look.distance > CLOTHES)].sum()) for look in looks
    )
    return beyond / total if total else None


def clothes_share(
    observations: Observations, looks: Sequence[Look], positions: Sequence[int]
) -> float:
    """Share of the masks' light beyond what most clothes reach: how wide this person's are.

    Of frames that show the body.

    Args:
        observations: of which some frames are looked at.
        looks: at those frames.
        positions: theirs.
    """
    total = beyond = 0.0
    for position, look in zip(positions, looks, strict=True):
        if np.isfinite(look.distance).all():
            matte = observations.mattes[position].float()
            total += float(matte.sum())
            beyond += float(matte[torch.from_numpy(look.distance > CLOTHES)].sum())
    return beyond / total if total else 0.0


def _holes_share(looks: Sequence[Look]) -> float | None:
    insides = [binary_erosion(look.distance == 0, iterations=RIM) for look in looks]
    area = sum(int(inside.sum()) for inside in insides)
    missing = sum(
        float((1 - look.alpha.numpy()[inside]).sum())
        for look, inside in zip(looks, insides, strict=True)
    )
    return missing / area if area else None


def _needle_share(model: AvatarModel) -> float | None:
    gaussians = model.densified
    if gaussians is None or not len(gaussians):
        return None
    with torch.no_grad():
        scales, opacities = gaussians.scales.sort(1).values, gaussians.opacities
        needles = scales[:, 2] > NEEDLE * scales[:, 1]
        return float(opacities[needles].sum() / opacities.sum())


def _opacity_histogram(model: AvatarModel) -> list[float] | None:
    gaussians = model.densified
    if gaussians is None or not len(gaussians):
        return None
    counts, _ = np.histogram(gaussians.opacities.detach().cpu(), OPACITY_BINS, (0.0, 1.0))
    return [float(count) / len(gaussians) for count in counts]
