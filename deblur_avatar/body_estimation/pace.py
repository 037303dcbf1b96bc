"""Pace of a clip: where its frames stand in time, in frame intervals, gaps and all.

Frames that were dropped, and repeats that were left out, leave gaps. What a motion may do from one
frame to the next is counted in the time between them.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float, Float64
from torch import Tensor

SAME_PLACE = 2  # decimals of a frame to which times are rounded: clocks are not that good
CLOSEST = 0.5  # intervals; frames that a container puts closer together were not taken so


class Pace(NamedTuple):
    """Frames in time; `places` are 0, 1, 2, ... where they are evenly spaced."""

    interval: float  # seconds from frame to frame, as a rule
    places: Float64[Tensor, " F"]  # intervals from the first frame

    @property
    def steps(self) -> Float64[Tensor, " G"]:
        """Intervals from each frame to the next."""
        return self.places.diff()


def pace_of(timestamps: Float[Tensor, " F"]) -> Pace:
    """Of a clip's frames, by their times in seconds; one frame has an interval of a second."""
    if len(timestamps) < 2:
        return Pace(1.0, torch.zeros(len(timestamps), dtype=torch.float64))
    interval = float(timestamps.diff().median())
    places = ((timestamps - timestamps[0]).double() / interval).round(decimals=SAME_PLACE)
    steps = places.diff().clamp(min=CLOSEST)
    return Pace(interval, torch.cat([places[:1], steps.cumsum(0)]))


def second_differences(values: Float[Tensor, " F *rest"], pace: Pace) -> Float[Tensor, " G *rest"]:
    """Accelerations over time, in units of `values` by squared interval.

    Each is weighed by the root of the time it stands for, so that the sum of squares is an integral
    over time. Of evenly spaced frames they are the second differences.
    """
    before, after = pace.steps[:-1], pace.steps[1:]
    share = (2 / (before + after)).sqrt()
    shape = (-1, *[1] * (values.ndim - 1))
    early, late = ((share / step).to(values.dtype).view(shape) for step in (before, after))
    return late * values[2:] - (early + late) * values[1:-1] + early * values[:-2]
