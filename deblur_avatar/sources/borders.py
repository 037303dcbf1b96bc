"""Borders: bars of one colour that a player or an editor put around a picture.

They are no part of what the camera saw: a leg that ends at one is cut off by the picture, and the
field of view is the picture's. Two opposite bars are as wide as each other, and straight.
"""

import logging
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Int16, UInt8
from torch import Tensor

from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.sources.footage import Footage

logger = logging.getLogger(__name__)

LOOKED_AT = 48  # frames, evenly over the clip
SAME = 8  # of 255: how far encoders let a bar's pixels be from its colour
ALL = 0.995  # share of a line's pixels that are the bar's
EDGE = 10  # lines over which an encoder smears a bar's edge: a block of eight, and its filter
PICTURE = 0.95  # share of the lines across, of those that show anything, that the edge cuts
UNEQUAL = 0.01  # of the side, by which opposite bars may differ
LEAST = 0.02  # of the side: a narrower bar is some lines that an encoder spoilt
SMEARED = 0.05  # of the side: no more of it is an edge, in small pictures
NARROWEST = 0.25  # of the side: a narrower picture is somebody before one colour

Box = tuple[int, int, int, int]  # x, y, width, height


def without_borders(footage: Footage, name: str) -> Footage:
    """Cut the bars off, and say so.

    Args:
        footage: as read.
        name: what messages call it.
    """
    x, y, width, height = picture_inside(footage.frames)
    rows, columns = footage.frames.shape[1:3]
    if (width, height) == (columns, rows):
        return footage
    across, down = footage.recorded_size
    size = (round(width * across / columns), round(height * down / rows))
    logger.warning(
        "%s: bars are cut off, the picture is %d x %d of %d x %d", name, *size, across, down
    )
    frames = footage.frames[:, y : y + height, x : x + width].contiguous()
    return replace(footage, frames=frames, recorded_size=size)


def picture_inside(frames: UInt8[Tensor, "F H W 3"]) -> Box:
    """Where the picture is; the whole of it where it has no borders."""
    chosen = evenly_spaced(range(len(frames)), LOOKED_AT)
    looked = frames[chosen].numpy()
    height, width = looked.shape[1:3]
    rows, columns = _pair(looked), _pair(looked.transpose(0, 2, 1, 3))
    return columns[0], rows[0], width - sum(columns), height - sum(rows)


def _pair(frames: UInt8[np.ndarray, "F H W 3"]) -> tuple[int, int]:
    """Lines of the bars above and below; none unless both are there."""
    first, last = _bar(frames), _bar(frames[:, ::-1])
    count = frames.shape[1]
    if min(first, last) < LEAST * count or abs(first - last) > max(1, UNEQUAL * count):
        return 0, 0
    if count - first - last < NARROWEST * count:
        return 0, 0
    return first, last


def _bar(frames: UInt8[np.ndarray, "F H W 3"]) -> int:
    """Lines of the bar above; 0 where there is none, or it does not end in a straight edge."""
    colour = np.median(frames[:, 0].reshape(-1, 3), axis=0).astype(np.int16)
    most: Int16[np.ndarray, "H W"] = np.zeros(frames.shape[1:3], np.int16)
    for frame in frames:
        most = np.maximum(most, np.abs(frame.astype(np.int16) - colour).max(-1))
    other: Bool[np.ndarray, "H W"] = most > SAME
    inside = np.flatnonzero(other.mean(1) > 1 - ALL)
    if not len(inside):
        return 0
    start = int(inside[0])
    edge = max(2, min(EDGE, round(SMEARED * len(other))))
    across = other[start : start + edge, other.mean(0) > 1 - ALL].mean(1) >= PICTURE
    return start + int(across.argmax()) if across.any() else 0
