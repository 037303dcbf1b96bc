"""The terms of the objective, each a number that is 0 when nothing is wrong.

Conventions. Images are sRGB in [0, 1]; means run over all pixels and channels, so weights do not
depend on the resolution.
"""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from deblur_avatar.imaging.lpips import SMALLEST_SIDE, Lpips

STRUCTURE_SCALES = 3  # each half as fine as the one before
WINDOW = 7  # pixels, of `dissimilarity`
K1, K2 = 0.01, 0.03  # its stabilisers


def photometric(image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]) -> Float[Tensor, ""]:
    """Mean absolute difference."""
    return (image - target).abs().mean()


def structure(
    image: Float[Tensor, "H W 3"],
    target: Float[Tensor, "H W 3"],
    box: tuple[int, int, int, int],
) -> Float[Tensor, ""]:
    """Mean absolute difference of neighbouring pixels' differences, at three scales, in a box.

    The stand-in for LPIPS on the mask's box, whose network's weights cannot be shipped: it sees
    edges where `photometric` sees levels. Box: left, top, right, bottom; pixels.
    """
    left, top, right, bottom = box
    apart = (image - target)[top:bottom, left:right].permute(2, 0, 1)[None]
    total = image.new_zeros(())
    for _ in range(STRUCTURE_SCALES):
        if min(apart.shape[-2:]) < 2:
            break  # a box this small has no neighbours left to compare
        total = total + apart.diff(dim=-1).abs().mean() + apart.diff(dim=-2).abs().mean()
        apart = torch.nn.functional.avg_pool2d(apart, 2, ceil_mode=True)
    return total / (2 * STRUCTURE_SCALES)


def dissimilarity(
    image: Float[Tensor, "H W 3"],
    target: Float[Tensor, "H W 3"],
    box: tuple[int, int, int, int],
) -> Float[Tensor, ""]:
    """Half of 1 - SSIM at three scales, in a box; range 1, even windows of 7 pixels.

    Source: Wang et al., IEEE TIP 2004; another stand-in for LPIPS.
    """
    left, top, right, bottom = box
    pair = [p[top:bottom, left:right].permute(2, 0, 1)[None] for p in (image, target)]
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
        spread = xx - mean_x**2 + yy - mean_y**2 + K2**2
        total = total + (1 - level * (2 * (xy - mean_x * mean_y) + K2**2) / spread).mean() / 2
        pair = [torch.nn.functional.avg_pool2d(p, 2, ceil_mode=True) for p in pair]
    return total / STRUCTURE_SCALES


def perceptual(
    lpips: Lpips,
    image: Float[Tensor, "H W 3"],
    target: Float[Tensor, "H W 3"],
    box: tuple[int, int, int, int],
) -> Float[Tensor, ""]:
    """LPIPS of a box, whose pixels the network takes in [-1, 1].

    0 of a box with a side of under `SMALLEST_SIDE`, of which the network sees nothing.
    """
    left, top, right, bottom = box
    if min(right - left, bottom - top) < SMALLEST_SIDE:
        return image.new_zeros(())
    cut = (slice(top, bottom), slice(left, right))
    return lpips(image[cut][None], target[cut][None])[0]


def coverage(alpha: Float[Tensor, "H W"], matte: Float[Tensor, "H W"]) -> Float[Tensor, ""]:
    """Mean absolute difference of coverage."""
    return (alpha - matte).abs().mean()


def skinning(
    weights: Float[Tensor, "P J"], body_weights: Float[Tensor, "P J"]
) -> Float[Tensor, ""]:
    """Squared distance of learned blend weights from the body's own, on the body's surface.

    Source: 3DGS-Avatar, L_skin.
    """
    return (weights - body_weights).square().sum(1).mean()


def unevenness(values: Float[Tensor, "N D"], neighbours: Int64[Tensor, "N K"]) -> Float[Tensor, ""]:
    """Mean absolute difference between a Gaussian's values and its neighbours'.

    Where the camera sees a Gaussian the picture outweighs this; where it does not, values become
    those of the nearest that it does see. Absolute, so that an edge costs no more than a slope.
    """
    return _apart(values, neighbours).abs().mean()


def _apart(values: Float[Tensor, "N D"], neighbours: Int64[Tensor, "N K"]) -> Tensor:
    """Neighbours' values minus one's own, [D, K, N]: rows without strides, five times as fast."""
    rows, near = values.T.contiguous(), neighbours.T.contiguous()
    return rows.index_select(1, near.flatten()).unflatten(1, near.shape) - rows[:, None]
