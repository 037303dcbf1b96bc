"""Fades: where an editor let footage come out of one colour, or go over into it.

What such frames show is there, but fainter and fainter, and no camera ever saw it so.
"""

import numpy as np
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

HEIGHT = 36  # rows that contrast is measured at
BLANK = 0.05  # of the footage's usual contrast: a picture below shows nothing
PAUSE = 3  # blank frames in a row between two recordings: fewer are a mistake in one
RISE = 1.02  # times the contrast so far: while it rises so, a fade goes on
SETTLED = 6  # frames in a row in which it does not: the fade is over
WHOLE = 0.97  # of the contrast beside a fade: a picture that is none of it


def longest_without_fades(frames: UInt8[Tensor, "F H W 3"]) -> tuple[int, int]:
    """First frame and one past the last of the longest part between blank frames, without fades.

    All frames where none are blank, or all.
    """
    step = max(1, frames.shape[1] // HEIGHT)
    contrast = frames[:, ::step, ::step].float().mean(3).flatten(1).std(1, correction=0).numpy()
    blank = contrast <= BLANK * np.median(contrast)
    if blank.all() or not blank.any():
        return 0, len(frames)
    parts = [_without_fades(contrast, *part) for part in _between(blank)]
    return max(parts, key=lambda part: part[1] - part[0])


def _between(blank: Bool[np.ndarray, " F"]) -> list[tuple[int, int]]:
    """Parts of footage between blank frames, `PAUSE` in a row or at an end."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], blank, [False]]))).reshape(-1, 2)
    ends = [0, len(blank)]
    pauses = [(a, b) for a, b in edges.tolist() if b - a >= PAUSE or {a, b} & set(ends)]
    starts = [0, *(b for _, b in pauses)]
    stops = [*(a for a, _ in pauses), len(blank)]
    return [(a, b) for a, b in zip(starts, stops, strict=True) if b > a]


def _without_fades(contrast: Float[np.ndarray, " F"], first: int, stop: int) -> tuple[int, int]:
    """A part, less its fades from the blank frames before it and into those behind it."""
    inside = contrast[first:stop]
    low = _fade(inside) if first > 0 else 0
    high = _fade(inside[::-1]) if stop < len(contrast) else 0
    return (first + low, stop - high) if low + high < len(inside) else (first, stop)


def _fade(contrast: Float[np.ndarray, " F"]) -> int:
    """How many frames a fade from the first on takes."""
    most, last = 0.0, 0
    for index, value in enumerate(contrast):
        if value > RISE * most:
            most, last = float(value), index
        elif index - last >= SETTLED:
            break
    return int(np.argmax(contrast >= WHOLE * most))
