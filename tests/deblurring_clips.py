"""Clips of striped squares instead of persons, and a training of a second, for tests."""

import torch
from torch import Tensor

from deblur_avatar.artifacts.deblurring_clips import DeblurringClips
from deblur_avatar.training.deblurring import DstnetTrainingParams

TRAINING = DstnetTrainingParams(
    network={"features": 4, "blocks": 1, "refinements": 1}, iterations=40, batch=2, frames=3,
    size=16, rate=3e-3, final_rate=1e-5, rise=4, weight_decay=1e-4, frequencies=0.1,
)  # fmt: skip


def striped_clips(persons: int = 2, frames: int = 4, size: int = 32) -> DeblurringClips:
    """Squares with stripes that move to the right, blurred along the way."""
    place = torch.arange(size)
    instants = []
    for person in range(persons):
        shown = []
        for step in range(-4, 4 * frames + 1):
            inside = ((place - step - 6) >= 0) & ((place - step - 6) < 12)
            stripes = 120 + 100 * ((place - step) % (4 + person) > 1)
            rows = (place[:, None] > 6) & (place[:, None] < 26)
            matte = 255 * (inside & rows)
            colour = (
                torch.stack([stripes, stripes // 2, 255 - stripes], -1) * (matte > 0)[..., None]
            )
            shown.append(torch.cat([colour, matte[..., None]], -1))
        instants.append(torch.stack(shown))
    film = torch.stack(instants).float()  # [P, M, H, W, 4]
    middles = [4 * (frame + 1) for frame in range(frames)]
    sharp = _codes(film[:, middles])
    blurred = torch.stack(
        [
            torch.stack([_codes(film[:, m - reach : m + reach + 1].mean(1)) for m in middles], 1)
            for reach in (1, 3)
        ],
        1,
    )
    return DeblurringClips(
        sharp=sharp[..., :3].contiguous(),
        sharp_mattes=sharp[..., 3].contiguous(),
        blurred=blurred[..., :3].contiguous(),
        blurred_mattes=blurred[..., 3].contiguous(),
        windows=(3, 7),
        averaging_spaces=("srgb",) * persons,
    )


def _codes(values: Tensor) -> Tensor:
    return values.round().to(torch.uint8)
