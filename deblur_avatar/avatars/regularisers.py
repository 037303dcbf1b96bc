"""Penalties on an avatar itself, whatever it looks like; 0 when nothing is wrong."""

import math

from jaxtyping import Float
from torch import Tensor


def elongation(log_scales: Float[Tensor, "N 3"], longest: float) -> Float[Tensor, ""]:
    """By how much more than `longest` times the second scale the largest is, mean logarithm.

    One camera does not see how far a Gaussian reaches along its rays.

    Source: the bound on anisotropy of PhysGaussian (Xie et al., CVPR 2024), of the two larger
    scales, so that flat Gaussians stay free.
    """
    ordered = log_scales.sort(dim=1).values
    return (ordered[:, 2] - ordered[:, 1] - math.log(longest)).relu().mean()


def excess_height(
    heights: Float[Tensor, " N"], reach: Float[Tensor, " N"], most: float
) -> Float[Tensor, ""]:
    """By how many metres more than `most` Gaussians reach off the body's surface, mean.

    A hinge leaves clothes alone, and draws back what is beyond as hard however far it reaches.

    Args:
        heights: metres along the outward normal, negative inside.
        reach: metres across the surface, from a Gaussian's mean.
        most: metres, to either side.
    """
    return (heights.abs() + reach - most).relu().mean()


def skinning_distance(
    weights: Float[Tensor, "P J"], body_weights: Float[Tensor, "P J"]
) -> Float[Tensor, ""]:
    """Squared distance of learned blend weights from the body's own, on the body's surface.

    Source: 3DGS-Avatar, L_skin.
    """
    return (weights - body_weights).square().sum(1).mean()
