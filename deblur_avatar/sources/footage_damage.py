"""Damage that footage took on its way: repeated frames, and light that the camera regulated.

Conventions. F frames in order. A step is what changes from one frame to the next: the mean absolute
difference of their codes, seen at a small size. A conversion is a frame rate raised by repeats: of
every so many frames, always the same ones are copies.
"""

from fractions import Fraction

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, UInt8
from torch import Tensor

from deblur_avatar.imaging.plate_light import BRIGHT, DARK
from deblur_avatar.run import in_threads

ROWS = 180  # at which steps are seen: noise is averaged away, a person's motion is not
REPEATED = 0.2  # share of the smaller of the steps around that a repeated frame's step is below
OFTEN = 0.45  # that share for copies of a conversion: an encoder may lose a noisy repeat
CONVERSIONS = (  # so many pictures of so many frames, fewest first, so that no copy is left
    (1, 6), (1, 5), (1, 4), (1, 3), (2, 5), (5, 12), (1, 2),  # 10, 12, 15, 20, 24, 25, 30 in 60
    (3, 5), (2, 3), (3, 4), (4, 5), (5, 6),  # 30 in 50; 20 in 30, 45 in 60, 24 and 25 in 30
)  # fmt: skip
REGULAR = 0.9  # share of a conversion's copies that must be seen as such
JUDGED = 0.5  # share of those copies beside which something must move,
MOVING = 0.5  # by this share of a usual step: an encoder smears the noise of what stands still
LEAST_STEP = 0.02  # codes; steps below it are no motion, so nothing is told from them
FEWEST_REPEATS = 3  # at a place of the pattern before they are a change of frame rate
GAMMA = 2.2  # of codes, to say in stops how much light they stand for


def repeated_frames(frames: UInt8[Tensor, "F H W 3"]) -> list[int]:
    """Which frames show what the one before showed, up to what an encoder made of it.

    A frame equal to the last bit is one. So is one whose step is far below both steps around it:
    where a person stands still for several frames, all steps are alike. Where they follow a
    conversion's pattern from end to end, they are told from less, and come several in a row.
    """
    steps = _steps(frames)
    shares = _shares_of_steps_around(steps, np.ones(len(steps), np.bool_), LEAST_STEP)
    equal = {i for i in range(1, len(frames)) if torch.equal(frames[i], frames[i - 1])}
    single = {int(i) + 1 for i in np.flatnonzero(shares < REPEATED)}
    return sorted(equal | single | _copies_of_a_conversion(steps))


def _shares_of_steps_around(
    steps: Float64[np.ndarray, " steps"], among: Bool[np.ndarray, " steps"], least: float
) -> Float64[np.ndarray, " steps"]:
    """Each step as a share of the smaller of its neighbours `among`.

    Motion is more than `least`. Infinite beside no motion; NaN where the step is none either.
    """
    places, indices = np.flatnonzero(among), np.arange(len(steps))
    beyond = np.array([np.inf, *steps[places], np.inf])
    before = beyond[np.searchsorted(places, indices, side="left")]
    after = beyond[np.searchsorted(places, indices, side="right") + 1]
    around = np.minimum(before, after)
    moves = (around > least) & (around < np.inf)
    alone = np.where(steps > least, np.inf, np.nan)
    return np.where(moves, steps / np.where(moves, around, 1.0), alone)


def _copies_of_a_conversion(steps: Float64[np.ndarray, " steps"]) -> set[int]:
    for pictures, count in CONVERSIONS:
        for phase in range(count):
            shown = (np.arange(len(steps) + 1) + phase) * pictures // count
            copies = np.diff(shown) == 0
            if _are_copies(steps, copies, count):
                return {int(index) + 1 for index in np.flatnonzero(copies)}
    return set()


def _are_copies(
    steps: Float64[np.ndarray, " steps"], copies: Bool[np.ndarray, " steps"], period: int
) -> bool:
    """Nearly all of these steps are small beside the others, and most at each place of a period."""
    if copies.all() or not copies.any():
        return False
    least = max(LEAST_STEP, MOVING * float(np.median(steps[~copies])))
    shares = _shares_of_steps_around(steps, ~copies, least)
    small, judged = shares < OFTEN, ~np.isnan(shares)
    for place in range(min(period, len(steps))):
        here = slice(place, None, period)
        if copies[place] and not small[here].sum() >= max(FEWEST_REPEATS, judged[here].sum() / 2):
            return False
    found, seen = small[copies].sum(), judged[copies].sum()
    return bool(found >= REGULAR * seen and seen >= JUDGED * copies.sum())


def conversion(repeats: list[int], total: int) -> Fraction | None:
    """Repeats at the same places of every so many frames, from end to end: a converted frame rate.

    Returns:
        Pictures a frame (4/5 for 24 in 30 frames a second); None for repeats without such a
        pattern, too few, or between pictures that are not as even as whole frames allow.
    """
    repeated = np.isin(np.arange(1, total), repeats)
    if repeated.all() or not repeated.any():
        return None
    for period in range(2, total - 1):
        first = repeated[:period]
        if FEWEST_REPEATS * first.sum() > repeated.sum():
            return None
        if (repeated[period:] == repeated[:-period]).all():
            taken = np.flatnonzero(~first)
            apart = np.diff([*taken, taken[0] + period])
            return Fraction(len(taken), period) if np.ptp(apart) <= 1 else None
    return None


def mostly_copied(kept: list[int]) -> bool:
    """Nearly every picture comes more than once, and about as often: a conversion with slips."""
    times = np.diff(kept)
    alike = np.abs(times - np.median(times)) <= 1
    return len(times) >= FEWEST_REPEATS and bool((alike & (times > 1)).mean() >= REGULAR)


def evenly_respaced(
    timestamps: Float64[Tensor, " F"], kept: list[int], pictures: Fraction
) -> Float64[Tensor, " K"]:
    """When frames were taken before their rate was converted: at equal distances.

    Args:
        timestamps: of all frames, repeats included, seconds.
        kept: which are no repeats.
        pictures: a frame, as `conversion` says.
    """
    interval = float(timestamps.diff().median()) * pictures.denominator / pictures.numerator
    count = torch.arange(len(kept), dtype=torch.float64)
    return timestamps[kept[0]] + count * interval


def light_drift(frames: UInt8[Tensor, "F H W 3"]) -> Float[np.ndarray, " 3"]:
    """By how many stops the light of each colour goes up and down over the clip.

    From frame to frame the median pixel's light is compared, which a person's motion and a camera
    that moves slowly leave alone; changes add up.
    """
    small = in_threads(_small, frames)
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
    small = in_threads(_small, frames)
    pairs = zip(small, small[1:], strict=False)
    return np.array([np.abs(after - before).mean() for before, after in pairs], np.float64)


def _small(frame: UInt8[Tensor, "H W 3"]) -> Float[np.ndarray, "h w 3"]:
    height, width = frame.shape[:2]
    scale = min(1.0, ROWS / height)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return cv2.resize(frame.numpy().astype(np.float32), size, interpolation=cv2.INTER_AREA)
