"""Scores of a test view: the avatar's render against the ground truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.avatars.model import AvatarModel, render_avatar
from deblur_avatar.evaluation.truth_views import (
    TruthView,
)
from deblur_avatar.imaging import metrics
from deblur_avatar.imaging.color import srgb_to_linear
from deblur_avatar.imaging.lpips import lpips_vgg


@dataclass(frozen=True, eq=False)
class Comparison:
    """One test view and what the avatar made of it."""

    view: TruthView
    render: UInt8[Tensor, "H W 3"]
    difference: Float[Tensor, "H W"]  # FLIP
    scores: dict[str, float]


def compare(
    model: AvatarModel,
    observations: Observations,
    reference: Reference,
    view: TruthView,
    poses: Poses,
) -> Comparison:
    """Draw one test view in the pose that `poses` has for it, and score it.

    Colours are drawn with the latent code of the frame if it was trained on, else of the last one
    that was (as 3DGS-Avatar does).
    """
    trained = view.position in observations.train
    image, _ = render_avatar(
        model,
        poses.at([view.position]),
        observations.cameras.camera(view.camera),
        frame=view.position if trained else max(observations.train),
        background=_background(reference, model),
    )
    render = image.cpu()
    truth = view.image[None].float() / 255
    foreground, seen = view.foreground[None], view.seen[None]
    difference = metrics.flip_map(render, truth)
    scores = {
        "psnr": metrics.psnr(render, truth),
        "ssim": metrics.ssim(render, truth),
        "ssim_range2": metrics.ssim_range2(render, truth),
        "ms_ssim": metrics.ms_ssim(render, truth),
        "flip": difference.double().mean((1, 2)),
        "lpips_vgg": lpips_vgg(render, truth),
        "psnr_foreground": metrics.psnr(render, truth, foreground),
        "psnr_seen": metrics.psnr(render, truth, seen),
        "ssim_seen": metrics.ssim(render, truth, seen),
        "flip_seen": metrics.masked_mean(difference.double(), seen),
        "sharpness_ratio": metrics.sharpness_ratio(render, truth, foreground),
        "sharpness_ratio_seen": metrics.sharpness_ratio(render, truth, seen),
    }
    return Comparison(
        view=view,
        render=(render[0].clamp(0, 1) * 255).round().to(torch.uint8),
        difference=difference[0],
        scores={name: float(value) for name, value in scores.items()},
    )


def _background(reference: Reference, model: AvatarModel) -> Float[Tensor, " 3"]:
    color = torch.tensor(reference.background)
    light = srgb_to_linear(color) if model.light == "linear" else color
    return light.to(model.betas)


def mean_scores(comparisons: Sequence[Comparison]) -> dict[str, float | None] | None:
    """Mean of each score over pictures, where it was measured."""
    if not comparisons:
        return None
    means: dict[str, float | None] = {}
    for name in comparisons[0].scores:
        values = torch.tensor([comparison.scores[name] for comparison in comparisons])
        measured = values[~values.isnan()]
        means[name] = float(measured.double().mean()) if len(measured) else None
    return means
