"""Training recipe: losses, learning rates, densification, fusion."""

from typing import Annotated, Literal

from pydantic import Field

from deblur_avatar.avatars.params import ModelParams
from deblur_avatar.config.section import (
    Count,
    Fraction,
    NonNegative,
    Params,
    Positive,
)


class LossParams(Params):
    """Weights of the terms of the objective."""

    l1: NonNegative
    lpips: NonNegative  # inside the person's box, in place of `structure`; only with its weights
    structure: NonNegative  # edges at three scales inside the person's box
    dissimilarity: NonNegative  # 1 - SSIM at three scales there
    mask: NonNegative
    skinning_early: NonNegative  # until `skinning_switch`
    skinning_late: NonNegative
    isometry_means: NonNegative  # neighbours keep their distances
    isometry_covars: NonNegative
    even_colors: (
        NonNegative  # of a body of which nothing is seen: neighbours' raw colours are alike
    )
    even_shapes: NonNegative  # their raw scales and opacities
    even_heights: NonNegative  # and how far they stand off the body
    anchor: NonNegative  # clip motion: knots stay near the first estimate
    depth: NonNegative  # clip motion: so do joints' distances from the camera, where depth is known
    shutter: NonNegative  # clip motion: an estimated shutter stays near the first guess


class DensifyParams(Params):
    """Where Gaussians are added and taken away."""

    start: Count
    stop: Count
    every: Count
    gradient: Positive  # of the screen position, in half image widths
    clone_below_m: Positive
    prune_opacity: Fraction
    prune_scale_m: Positive
    most: Positive  # times the first count


class OptimiserParams(Params):
    """Learning rates, and when what starts. Iterations count as in the paper's 15,000."""

    means: Positive
    means_final: Positive
    features: Positive
    opacities: Positive
    scales: Positive
    quats: Positive
    rigid: Positive
    nonrigid: Positive
    color: Positive
    latent_decay: NonNegative
    poses: Positive  # radians a step
    transl: Positive  # metres a step
    shutter: Positive  # share of itself a step, where it is estimated
    fusion: Positive
    final_share: Fraction  # of the networks' rates at the end
    clip: Positive  # norm of all networks' gradients
    gaussians_start: Annotated[int, Field(ge=0)]
    nonrigid_start: Annotated[int, Field(ge=0)]
    skinning_switch: Annotated[int, Field(ge=0)]
    pose_noise: NonNegative  # of the conditioning rotations, in half of the steps


class StartParams(Params):
    """What an avatar is made of and how it is fitted; methods that agree on it share a warm-up."""

    model: ModelParams
    optimiser: OptimiserParams
    losses: LossParams
    densify: DensifyParams
    exposure_gain: Literal["none", "frame"]  # frame: each may be brighter than the clip, or darker
