"""Losses of pictures: how far renders are from a frame, 0 when nothing is wrong.

`LOSSES` is the table: a row says what of a picture a loss sees and how it compares two. Its weight
has the row's name in the section `losses` of a recipe. What an avatar or a trajectory is held to
for itself are their `regularisers` and `priors`.

Conventions. Images are sRGB in [0, 1]; means run over all pixels and channels, so weights do not
depend on the resolution.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.imaging.lpips import SMALLEST_SIDE, configured_lpips

# Not parameters: they define what the loss is, and its weight was chosen with them.
STRUCTURE_SCALES = 3  # each half as fine as the one before
WINDOW = 7  # pixels, of `dissimilarity`
K1, K2 = 0.01, 0.03  # its stabilisers (Wang et al. 2004)

Comparison = Callable[[Tensor, Tensor], Float[Tensor, ""]]


@dataclass(frozen=True)
class Loss:
    """One row: how two pictures are compared, and where.

    region: the `picture`, the person's `box` in it, or the `coverage` (alpha with the matte).
    on: makes the comparison for a device; None where this machine lacks what it takes.
    substitute_for: the loss in whose absence this one counts, where they see the same.
    name_in_records: what the losses' sight of structure is called in a run's measurements.
    """

    region: Literal["picture", "box", "coverage"]
    on: Callable[[torch.device], Comparison | None]
    substitute_for: str | None = None
    name_in_records: str | None = None


def everywhere(compare: Comparison) -> Callable[[torch.device], Comparison]:
    """A comparison that needs nothing, on any device."""
    return lambda device: compare


def photometric(image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]) -> Float[Tensor, ""]:
    """Mean absolute difference."""
    return (image - target).abs().mean()


def structure(image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]) -> Float[Tensor, ""]:
    """Mean absolute difference of neighbouring pixels' differences, at three scales.

    The stand-in for LPIPS, whose network's weights cannot be shipped: it sees edges where
    `photometric` sees levels.
    """
    apart = (image - target).permute(2, 0, 1)[None]
    total = image.new_zeros(())
    for _ in range(STRUCTURE_SCALES):
        if min(apart.shape[-2:]) < 2:
            break  # a box this small has no neighbours left to compare
        total = total + apart.diff(dim=-1).abs().mean() + apart.diff(dim=-2).abs().mean()
        apart = torch.nn.functional.avg_pool2d(apart, 2, ceil_mode=True)
    return total / (2 * STRUCTURE_SCALES)


def dissimilarity(
    image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]
) -> Float[Tensor, ""]:
    """Half of 1 - SSIM at three scales; range 1, even windows of 7 pixels.

    Source: Wang et al., IEEE TIP 2004; another stand-in for LPIPS.
    """
    pair = [p.permute(2, 0, 1)[None] for p in (image, target)]
    total = image.new_zeros(())
    for _ in range(STRUCTURE_SCALES):
        if min(pair[0].shape[-2:]) < WINDOW:
            break  # no window fits
        x, y = pair
        mean_x, mean_y, xx, yy, xy = (
            torch.nn.functional.avg_pool2d(moment, WINDOW, 1)
            for moment in (x, y, x * x, y * y, x * y)
        )
        level = (2 * mean_x * mean_y + K1**2) / (mean_x**2 + mean_y**2 + K1**2)
        scale = xx - mean_x**2 + yy - mean_y**2 + K2**2
        total = total + (1 - level * (2 * (xy - mean_x * mean_y) + K2**2) / scale).mean() / 2
        pair = [torch.nn.functional.avg_pool2d(p, 2, ceil_mode=True) for p in pair]
    return total / STRUCTURE_SCALES


def perceptual(device: torch.device) -> Comparison | None:
    """LPIPS, where its weights are given; 0 of a side of under `SMALLEST_SIDE`.

    Source: Zhang et al., CVPR 2018.
    """
    network = configured_lpips()
    if network is None:
        return None
    lpips = network.to(device)

    def compare(image: Tensor, target: Tensor) -> Tensor:
        if min(image.shape[:2]) < SMALLEST_SIDE:
            return image.new_zeros(())
        return lpips(image[None], target[None])[0]

    return compare


def coverage(alpha: Float[Tensor, "H W"], matte: Float[Tensor, "H W"]) -> Float[Tensor, ""]:
    """Mean absolute difference of coverage."""
    return (alpha - matte).abs().mean()


LOSSES: dict[str, Loss] = {
    "l1": Loss("picture", everywhere(photometric)),
    "lpips": Loss("box", perceptual, name_in_records="lpips_vgg"),
    "structure": Loss(
        "box", everywhere(structure), substitute_for="lpips", name_in_records="edges"
    ),
    "dissimilarity": Loss("box", everywhere(dissimilarity)),
    "mask": Loss("coverage", everywhere(coverage)),
}
