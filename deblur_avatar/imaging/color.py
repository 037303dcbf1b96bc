"""Colour spaces: sRGB and the linear light it stands for.

Conventions. `srgb` values are what image files hold, scaled to [0, 1]; `linear` values are
proportional to light, with the same black and white. Both functions take any shape, go beyond
[0, 1] smoothly enough for an optimiser (straight below 0, the power law above 1), and have finite
gradients everywhere.

Source: IEC 61966-2-1:1999.
"""

import torch
from jaxtyping import Float
from torch import Tensor

# The constants of the standard. Its two pieces meet to within 3e-8 of the curve at this knee.
LINEAR_KNEE = 0.0031308
SRGB_KNEE = 0.04045
SLOPE = 12.92
OFFSET = 0.055
EXPONENT = 2.4


def srgb_to_linear(srgb: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Turn sRGB values into light."""
    # A safe input first, so that the branch not taken cannot send NaN into the gradient.
    curve = ((srgb.clamp(min=SRGB_KNEE) + OFFSET) / (1 + OFFSET)) ** EXPONENT
    return torch.where(srgb <= SRGB_KNEE, srgb / SLOPE, curve)


def linear_to_srgb(linear: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Turn light into sRGB values."""
    curve = (1 + OFFSET) * linear.clamp(min=LINEAR_KNEE) ** (1 / EXPONENT) - OFFSET
    return torch.where(linear <= LINEAR_KNEE, linear * SLOPE, curve)
