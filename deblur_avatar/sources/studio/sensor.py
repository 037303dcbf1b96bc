"""Camera sensor: exposure row by row, drifting gain, shot and read noise.

Conventions. Linear light, 1 for white. S instants a frame, at equal distances; a row's exposure is
the mean of `instants` of them, later rows take later ones (rolling shutter).
"""

import math

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.config.section import NonNegative, Params, Positive
from deblur_avatar.imaging.color import linear_to_srgb
from deblur_avatar.imaging.exposure import mean_of_instants


class NoiseParams(Params):
    """Shot and read noise: variance = shot * light + read^2."""

    shot: NonNegative
    read: NonNegative


class DriftParams(Params):
    """Automatic exposure that hunts: a gain of 2^(stops * sine), and a tint that goes with it."""

    stops: NonNegative
    tint_stops: NonNegative  # red up while blue goes down
    period_s: Positive


class RollingShutterParams(Params):
    """Rows read one after another."""

    readout: Positive  # from the first row to the last, as a share of the frame interval


def instants_of_frame(instants: int, exposure: float, readout: float) -> Float[Tensor, " S"]:
    """Times to be seen for one frame, seconds from the middle of its middle row's exposure.

    Args:
        instants: of each row's exposure.
        exposure: seconds the shutter is open.
        readout: seconds from the first row to the last.
    """
    step = exposure / instants
    count = instants + round(readout / step)
    return (torch.arange(count, dtype=torch.float64) - (count - 1) / 2) * step


def expose_rows(seen: Float[Tensor, "S H *row"], instants: int) -> Float[Tensor, " H *row"]:
    """Average the instants of each row's exposure: all rows the same ones, or later rows later."""
    late = len(seen) - instants
    rows = seen.shape[1]
    first = torch.round(torch.arange(rows) / max(rows - 1, 1) * late).long()
    pieces = [
        mean_of_instants(seen[start : start + instants, first == start])
        for start in range(late + 1)
    ]
    return torch.cat(pieces)


def gains(time: float, params: DriftParams | None) -> Float[Tensor, " 3"]:
    """What each colour's light is multiplied by at a time."""
    if params is None:
        return torch.ones(3)
    wave = math.sin(2 * math.pi * time / params.period_s)
    tint = torch.tensor([1.0, 0.0, -1.0]) * params.tint_stops
    return 2.0 ** (wave * (params.stops + tint))


def record(
    light: Float[Tensor, "H W 3"],
    gain: Float[Tensor, " 3"],
    noise: NoiseParams | None,
    generator: torch.Generator,
) -> UInt8[Tensor, "H W 3"]:
    """Turn the light of one exposure into 8-bit sRGB."""
    light = light * gain
    if noise is not None:
        deviation = (noise.shot * light.clamp(min=0) + noise.read**2).sqrt()
        light = light + deviation * torch.randn(light.shape, generator=generator)
    return (linear_to_srgb(light.clamp(0, 1)) * 255).round().to(torch.uint8)
