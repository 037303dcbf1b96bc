"""Standard error of an estimated shutter: how surely blurred frames tell how long it was open.

Conventions. Shutters are compared by the natural logarithm of their ratio to a first guess, so that
0.1 is some ten per cent. All else that was fitted is taken as it is. None of the constants is a
parameter: they define what is reported, and changing one would only change its meaning.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.imaging.exposure import GUESS_STD

# The render of one frame [H, W, 3], had the logarithm of the shutter been this.
Exposed = Callable[[int, float], Tensor]

MAX_LOG_RATIO = math.log(4)  # an estimated shutter is between a quarter and four times the guess
STEP = 0.05  # to either side, where a picture's change with the shutter is measured
MIN_VALUE = 1 / 255  # root mean square change of the person's pixels with a shutter twice as long
PARTS = 8  # of the clip; frames next to each other share most of what is wrong with them


def shutter_std(exposed: Exposed, log_shutter: Tensor, observations: Observations) -> float:
    """Standard deviation of the logarithm of the shutter, as training frames alone tell it.

    Each part of the clip has a shutter of its own that explains it best: a Gauss-Newton step from
    the fitted one. How these disagree, and how far they lie from the fitted one in the mean, is
    the error; so neighbouring pixels and frames, which share theirs, do not count as many.

    Returns:
        Infinity where no picture changes with the shutter by more than it is rounded, and of a
        single frame.

    Source: the sandwich estimator with clusters (Huber 1967; Liang and Zeger 1986) of least squares
    on the pixels.
    """
    frames = observations.shown
    parts = min(PARTS, len(frames))
    slopes, curvatures = torch.zeros(parts), torch.zeros(parts)
    middle = float(log_shutter.detach().clamp(STEP - MAX_LOG_RATIO, MAX_LOG_RATIO - STEP))
    for place, index in enumerate(frames):
        slope, curvature = _residuals(exposed, middle, observations, index)
        slopes[place * parts // len(frames)] += slope
        curvatures[place * parts // len(frames)] += curvature
    values = 3 * float(observations.mattes[frames].sum()) / 255
    change = GUESS_STD * math.sqrt(float(curvatures.sum()) / max(values, 1))
    if parts < 2 or change < MIN_VALUE:
        return math.inf
    variance = slopes.square().sum() * parts / (parts - 1)
    return float(variance.sqrt() / curvatures.sum())


def _residuals(
    exposed: Exposed, middle: float, observations: Observations, index: int
) -> tuple[float, float]:
    """Slope and curvature of half the squared residuals of one frame over the shutter."""
    seen = observations.comparable_part(observations.frames[index].float() / 255, index)
    shorter, here, longer = (
        observations.comparable_part(exposed(index, middle + step), index)
        for step in (-STEP, 0.0, STEP)
    )
    change = (longer - shorter) / (2 * STEP)
    return float((change * (here - seen)).sum()), float(change.square().sum())
