"""Shot boundaries: where one recording ends and the next begins.

A clip is one recording of one person. Films that were edited hold several, and a person who is
somewhere else in the next frame has not moved there.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import UInt8
from scenedetect.detectors import AdaptiveDetector
from torch import Tensor

HEIGHT = 144  # rows that pictures are compared at: sums over all pixels need no more
WINDOW = 2  # frames on either side whose change a cut's stands out of
FEW = 2 * WINDOW + 2


def shot_starts(frames: UInt8[Tensor, "F H W 3"]) -> list[int]:
    """Indices of frames that another recording begins with, 0 among them.

    PySceneDetect's adaptive detector: a change of hue, saturation and brightness that is three
    times that of the frames around, so that neither a fast pan nor a blurred dancer is a cut.
    A flash, after which all is as before, is none either. Dissolves, cuts that change little of
    the picture, and one of two cuts within two frames may not be found; of fewer frames than `FEW`
    nothing is said.
    """
    if len(frames) < FEW:
        return [0]
    step = max(1, frames.shape[1] // HEIGHT)
    small = frames[:, ::step, ::step].flip(-1).numpy()  # the detector takes blue first
    cuts = _cuts(small)
    brief = [(a, b) for a, b in pairwise(cuts) if b - a <= WINDOW]
    inside = {index for span in brief for index in range(*span)}
    steady = [index for index in range(len(small)) if index not in inside]
    apart = {steady[index] for index in _cuts(small[steady])}
    flashes = {edge for a, b in brief if b not in apart for edge in (a, b)}
    return [0, *(index for index in cuts if index not in flashes)]


def _cuts(pictures: UInt8[np.ndarray, "F H W 3"]) -> list[int]:
    """Where a picture differs from the one before as no other around does."""
    detector = AdaptiveDetector(min_scene_len=1, window_width=WINDOW)
    # A cut beside the first or last frame has no neighbours on one side: there nothing moves.
    padded = [pictures[0], *pictures, *[pictures[-1]] * WINDOW]
    found = {
        index - 1
        for number, picture in enumerate(padded)
        for index in detector.process_frame(number, np.ascontiguousarray(picture))
    }
    return sorted(found - {0})


def longest_shot(starts: list[int], count: int) -> tuple[int, int]:
    """First frame and one past the last of the longest recording; the first of equals."""
    ends = [*starts[1:], count]
    return max(zip(starts, ends, strict=True), key=lambda shot: shot[1] - shot[0])
