"""Pixel patches: which pixels of a picture a step of fitting draws, and what each stands for.

A volume is drawn ray by ray, too slowly for whole pictures in every step. A step draws square
patches in random places, most of them on the person. The gradient of what is drawn is weighed by
how rarely that happens where patches mostly are: the mean over many draws is there the gradient of
whole pictures, so that the motion's priors weigh against it what they do for other avatars.

Conventions. A patch is named by its corner, the pixel at its top left. H rows, W columns, P pixels.

Source: HumanNeRF (Weng et al., CVPR 2022). As there, pixels that are drawn more rarely count less.
"""

from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int64
from pydantic import Field
from torch import Tensor

from deblur_avatar.config.section import Count, Params


class RaysParams(Params):
    """Which rays are cast in a step of fitting."""

    patches: Count
    size: Count  # pixels along a patch's side
    on_person: Annotated[float, Field(ge=0, lt=1)]  # share of patches whose middle shows the body
    coarse: Count  # pixels from ray to ray where no patch lies; these have no gradient


@dataclass(frozen=True)
class DrawnPixels:
    """Pixels (column, row), and by what their gradients are multiplied."""

    pixels: Int64[Tensor, "P 2"]
    weights: Float[Tensor, " P"]


def patch_middles(
    likely: Bool[Tensor, "H W"], possible: Bool[Tensor, "H W"], on_person: float
) -> Float[Tensor, "H W"]:
    """Probability that a patch's middle is in a pixel.

    Args:
        likely: pixels that show the body.
        possible: pixels that could show anything.
        on_person: share of the patches that go to the likely ones.

    Returns:
        Probabilities that sum to 1; the same everywhere, if nothing can be seen.
    """
    shares = torch.ones(likely.shape, device=likely.device) / likely.numel()
    if possible.any():
        shares = possible / possible.sum()
    if likely.any():
        shares = on_person * likely / likely.sum() + (1 - on_person) * shares
    return shares


def draw_patches(
    middles: Float[Tensor, "H W"], patches: int, size: int, generator: torch.Generator
) -> DrawnPixels:
    """Draw patches, which lie in the picture as a whole.

    Args:
        middles: probability that a patch's middle is in a pixel.
        patches: how many; they may overlap.
        size: of their sides; smaller where the picture is.
        generator: of the draws.
    """
    size = min(size, *middles.shape)
    corners = _corners(middles, size)
    shares = corners.flatten().cpu()
    chosen = torch.multinomial(shares, patches, replacement=True, generator=generator)
    drawn = torch.bincount(chosen, minlength=len(shares)).to(corners).reshape(corners.shape)
    counts, expected = _covered(drawn, size).round(), patches * _covered(corners, size)
    rows, columns = torch.nonzero(counts, as_tuple=True)
    usual = (middles * expected).sum()  # of the pixels in patches' middles
    return DrawnPixels(torch.stack([columns, rows], dim=1), counts[rows, columns] / usual)


def weighed(values: Float[Tensor, "P C"], weights: Float[Tensor, " P"]) -> Float[Tensor, "P C"]:
    """The same values, whose gradients are multiplied by weights."""
    still = values.detach()
    return still + weights[:, None] * (values - still)


def _corners(middles: Tensor, size: int) -> Float[Tensor, "h w"]:
    """Probability that a patch's corner is in a pixel."""
    corners = middles
    for axis, length in enumerate(middles.shape):
        place = (torch.arange(length, device=middles.device) - size // 2).clamp(0, length - size)
        shape = [*corners.shape]
        shape[axis] = length - size + 1
        corners = corners.new_zeros(shape).index_add(axis, place, corners)
    return corners


def _covered(corners: Tensor, size: int) -> Float[Tensor, "H W"]:
    """What patches with a number at their corner add up to in each pixel."""
    sums = torch.nn.functional.pad(corners[None, None], [size - 1] * 4)
    for window in ((size, 1), (1, size)):
        sums = torch.nn.functional.avg_pool2d(sums, window, 1, divisor_override=1)
    return sums[0, 0]
