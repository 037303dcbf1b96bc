"""Frequency encoding: numbers as sines and cosines of ever shorter waves.

A network that sees positions alone is slow to learn what changes over short distances.

Conventions. Frequencies are 1, 2, 4, ... radians a unit of what is encoded; F is how many. A
*window* weighs them: it opens from the longest wave to the shortest.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor


def frequency_encoding(
    values: Float[Tensor, "P D"], frequencies: int, window: Sequence[float] | None = None
) -> Float[Tensor, "P E"]:
    """Encode values as 2 F D numbers: frequency by frequency all sines, then all cosines.

    Args:
        values: what is encoded, without themselves.
        frequencies: F.
        window: weight of each frequency; None for all of them.

    Raises:
        ValueError: if the window has not one weight a frequency.

    Source: Mildenhall et al., "NeRF", ECCV 2020, without its factor pi, as in HumanNeRF's code.
    """
    if window is not None and len(window) != frequencies:
        raise ValueError(f"a window must have {frequencies} weights, got {len(window)}")
    waves = 2.0 ** torch.arange(frequencies, dtype=values.dtype, device=values.device)
    phases = values[:, None, :] * waves[:, None]
    encoded = torch.stack([phases.sin(), phases.cos()], dim=2)
    if window is not None:
        encoded = encoded * values.new_tensor(window)[:, None, None]
    return encoded.flatten(1)


def hann_window(share: float, frequencies: int) -> tuple[float, ...]:
    """Weights of frequencies while detail is let in: none at a share of 0, all at 1.

    Each rises as half a cosine, one after the other.

    Source: Park et al., "Nerfies", ICCV 2021, and HumanNeRF (Weng et al., CVPR 2022).
    """
    opened = (min(max(share * frequencies - index, 0.0), 1.0) for index in range(frequencies))
    return tuple((1 - math.cos(math.pi * part)) / 2 for part in opened)
