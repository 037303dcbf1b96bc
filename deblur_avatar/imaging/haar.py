"""Haar wavelets: a picture as its means and its differences at half the size, and back.

Conventions. Of the four pixels a b / c d of a square, the low band is their mean, and the high
bands are a quarter of (a + c) - (b + d), (a + b) - (c + d) and (a + d) - (b + c), in this order,
each for all channels. C channels, h = H / 2, w = W / 2; sizes are even.

Source: Mallat, "A theory for multiresolution signal decomposition", IEEE PAMI 1989; scaled so that
the low band has the picture's own brightness.
"""

import torch
from jaxtyping import Float
from torch import Tensor


def haar(
    image: Float[Tensor, "*batch C H W"],
) -> tuple[Float[Tensor, "*batch C h w"], Float[Tensor, "*batch D h w"]]:
    """Split planes into the low band and the three high bands, D = 3 C."""
    top, bottom = image[..., 0::2, :], image[..., 1::2, :]
    a, b = top[..., 0::2], top[..., 1::2]
    c, d = bottom[..., 0::2], bottom[..., 1::2]
    left, right, falling, rising = a + c, b + d, a + d, b + c
    high = torch.cat([left - right, (a + b) - (c + d), falling - rising], -3)
    return (left + right) / 4, high / 4


def inverse_haar(
    low: Float[Tensor, "*batch C h w"], high: Float[Tensor, "*batch D h w"]
) -> Float[Tensor, "*batch C H W"]:
    """Join what `haar` split."""
    across, down, diagonal = high.chunk(3, -3)
    top = torch.stack([low + across + down + diagonal, low - across + down - diagonal], -1)
    bottom = torch.stack([low + across - down - diagonal, low - across - down + diagonal], -1)
    return torch.stack([top.flatten(-2), bottom.flatten(-2)], -2).flatten(-3, -2)
