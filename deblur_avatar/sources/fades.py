"""Fades: where an editor let footage come out of one colour, or go over into it.

What such frames show is there, but fainter and fainter, and no camera ever saw it so.
"""

import numpy as np
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from deblur_avatar.sources.shots import same_place, small_pictures

HEIGHT = 36  # rows that contrast is measured at
BLANK = 0.05  # of the footage's usual contrast: a picture below shows nothing
PAUSE = 3  # blank frames in a row between two recordings: fewer are a mistake in one
DIP = 0.15  # of the usual contrast, at most: a frame between two fades that meet
BESIDE = 0.5  # of the usual contrast, at most, on either side of it
RISE = 1.02  # times the contrast so far: while it rises so, a fade goes on
SETTLED = 6  # frames in a row in which it does not: the fade is over
WHOLE = 0.97  # of the contrast beside a fade: a picture that is none of it


def longest_without_fades(frames: UInt8[Tensor, "F H W 3"]) -> tuple[int, int]:
    """First frame and one past the last of the longest recording, without its fades.

    Recordings are parted by blank frames, or by faint ones in which one fade meets the next. All
    frames where there are none of either, or all are blank.
    """
    step = max(1, frames.shape[1] // HEIGHT)
    contrast = frames[:, ::step, ::step].float().mean(3).flatten(1).std(1, correction=0).numpy()
    contrast = contrast / max(float(np.median(contrast)), 1e-9)
    if (contrast <= BLANK).all():
        return 0, len(frames)
    between = np.zeros(len(frames), bool)
    for first, stop in (*_pauses(contrast), *_dips(contrast, frames)):
        between[first:stop] = True
    parts = [_without_fades(contrast, *part) for part in _runs(~between)]
    return max(parts, key=lambda part: part[1] - part[0])


def _pauses(contrast: Float[np.ndarray, " F"]) -> list[tuple[int, int]]:
    """Blank frames, `PAUSE` in a row or at an end."""
    ends = {0, len(contrast)}
    return [(a, b) for a, b in _runs(contrast <= BLANK) if b - a >= PAUSE or {a, b} & ends]


def _dips(
    contrast: Float[np.ndarray, " F"], frames: UInt8[Tensor, "F H W 3"]
) -> list[tuple[int, int]]:
    """Faint frames, however few, between a fade out and a fade in at another place.

    Halfway down a fade the picture is where it was; a camera that pans past a wall has gone on.
    Beside the fades pictures are whole for `SETTLED` frames or more.
    """
    found = []
    for a, b in _runs(contrast <= DIP):
        if a == 0 or b == len(contrast) or max(contrast[a - 1], contrast[b]) > BESIDE:
            continue
        out, into = _fade(contrast[a - 1 :: -1]), _fade(contrast[b:])
        if min(a - out, len(contrast) - b - into) < SETTLED:
            continue
        sides = [a - 1 - out, a - 1 - out // 2, b + into // 2, b + into]
        whole, half, half_again, whole_again = small_pictures(frames[sides])
        fades = same_place(whole, half) and same_place(half_again, whole_again)
        if fades and not same_place(whole, whole_again):
            found.append((a, b))
    return found


def _runs(are: Bool[np.ndarray, " F"]) -> list[tuple[int, int]]:
    """First and one past the last of each row of frames that are."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], are, [False]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


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
