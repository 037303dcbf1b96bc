"""Dynamic filters: 3 x 3 kernels that a network predicts for each channel, or for each pixel too.

Conventions. Taps are in the order of rows; borders go on as zeros. F pictures, C channels.

Source: Jia et al., "Dynamic filter networks", NeurIPS 2016.
"""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

TAPS = 9
MIDDLE = TAPS // 2


def filter_by_channel(
    image: Float[Tensor, "F C H W"], taps: Float[Tensor, "F C 9"]
) -> Float[Tensor, "F C H W"]:
    """Filter each channel of each picture with a kernel of its own."""
    planes = image.flatten(0, 1)[None]
    kernels = taps.reshape(-1, 1, 3, 3)
    return functional.conv2d(planes, kernels, padding=1, groups=len(kernels)).view_as(image)


def filter_by_pixel(
    image: Float[Tensor, "F C H W"], taps: Float[Tensor, "F C 9 H W"]
) -> Float[Tensor, "F C H W"]:
    """Filter each pixel of each channel with a kernel of its own."""
    height, width = image.shape[-2:]
    padded = functional.pad(image, (1, 1, 1, 1))
    total = torch.zeros_like(image)
    for index, tap in enumerate(taps.unbind(2)):
        row, column = divmod(index, 3)
        total = total + padded[..., row : row + height, column : column + width] * tap
    return total
