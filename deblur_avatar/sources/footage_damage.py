"""Damage that footage took on its way: repeated frames, and light that the camera regulated.

Conventions. F frames in order. A step is what changes from one frame to the next: the mean absolute
difference of their codes, seen at a small size.
"""

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float64, UInt8
from torch import Tensor

ROWS = 180  # at which steps are seen: noise is averaged away, a person's motion is not
REPEATED = 0.2  # share of the smaller of the steps around that a repeated frame's step is below
OFTEN = 0.45  # that share where every n-th frame is as small: an encoder may lose a noisy repeat
PERIODS = (5, 6, 2, 3, 4)  # n: 24 or 25 frames in 30, 15 in 30, ...
REGULAR = 0.9  # share of every n-th frame that must be a repeat
LEAST_STEP = 0.02  # codes; steps below it are no motion, so nothing is told from them
FEWEST_REPEATS = 3  # at equal distances before they are a change of frame rate
BRIGHT, DARK = 235, 24  # codes between which light is proportional enough to compare
GAMMA = 2.2  # of codes, to say in stops how much light they stand for


def repeated_frames(frames: UInt8[Tensor, "F H W 3"]) -> list[int]:
    """Which frames show what the one before showed, up to what an encoder made of it.

    A frame equal to the last bit is one. So is one whose step is far below both steps around it:
    where a person stands still for several frames, all steps are alike. Where every n-th frame is
    one, they are told from less.
    """
    steps = _steps(frames)
    shares = _shares_of_steps_around(steps)
    equal = {i for i in range(1, len(frames)) if torch.equal(frames[i], frames[i - 1])}
    single = {int(i) + 1 for i in np.flatnonzero(shares < REPEATED)}
    return sorted(equal | single | _every_nth(shares))


def _shares_of_steps_around(
    steps: Float64[np.ndarray, " steps"],
) -> Float64[np.ndarray, " steps"]:
    """Each step as a share of the smaller of its neighbours; 1 where those are no motion."""
    shares = np.ones_like(steps)
    for index in range(len(steps)):
        around = np.concatenate([steps[max(index - 1, 0) : index], steps[index + 1 : index + 2]])
        if len(around) and around.min() > LEAST_STEP:
            shares[index] = steps[index] / around.min()
    return shares


def _every_nth(shares: Float64[np.ndarray, " steps"]) -> set[int]:
    for period in PERIODS:
        for phase in range(period):
            found = shares[phase::period] < OFTEN
            if len(found) >= FEWEST_REPEATS and found.mean() >= REGULAR:
                return {phase + 1 + period * index for index in range(len(found))}
    return set()


def conversion_period(repeats: list[int], total: int) -> int | None:
    """Every n-th frame is a repeat, from end to end: the sign of a converted frame rate.

    Returns:
        n (5 for 24 in 30 frames a second); None for repeats at other distances, or too few.
    """
    distances = set(np.diff(repeats).tolist())
    if len(repeats) < FEWEST_REPEATS or len(distances) != 1:
        return None
    (period,) = distances
    from_end_to_end = repeats[0] <= period and repeats[-1] >= total - period
    return period if period > 1 and from_end_to_end else None


def evenly_respaced(
    timestamps: Float64[Tensor, " F"], kept: list[int], period: int
) -> Float64[Tensor, " K"]:
    """When frames were taken before their rate was converted: at equal distances.

    Args:
        timestamps: of all frames, repeats included, seconds.
        kept: which are no repeats.
        period: every n-th is one.
    """
    interval = float(timestamps.diff().median()) * period / (period - 1)
    count = torch.arange(len(kept), dtype=torch.float64)
    return timestamps[kept[0]] + count * interval


def light_drift(frames: UInt8[Tensor, "F H W 3"]) -> Float[np.ndarray, " 3"]:
    """By how many stops the light of each colour goes up and down over the clip.

    From frame to frame the median pixel's light is compared, which a person's motion and a camera
    that moves slowly leave alone; changes add up.
    """
    small = [_small(frame) for frame in frames]
    stops = np.zeros((len(small), 3))
    for index in range(1, len(small)):
        pair = np.stack([small[index - 1], small[index]])
        for channel in range(3):
            codes = pair[..., channel].reshape(2, -1)
            before, after = codes[:, ((codes > DARK) & (codes < BRIGHT)).all(0)]
            change = np.median(np.log2(after / before)) * GAMMA if len(before) else 0.0
            stops[index, channel] = stops[index - 1, channel] + change
    return np.asarray(np.ptp(stops, axis=0))


def _steps(frames: UInt8[Tensor, "F H W 3"]) -> Float64[np.ndarray, " steps"]:
    small = [_small(frame) for frame in frames]
    pairs = zip(small, small[1:], strict=False)
    return np.array([np.abs(after - before).mean() for before, after in pairs], np.float64)


def _small(frame: UInt8[Tensor, "H W 3"]) -> Float[np.ndarray, "h w 3"]:
    height, width = frame.shape[:2]
    scale = min(1.0, ROWS / height)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return cv2.resize(frame.numpy().astype(np.float32), size, interpolation=cv2.INTER_AREA)
