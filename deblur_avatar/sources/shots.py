"""Shot boundaries: where one recording ends and the next begins.

A clip is one recording of one person. Films that were edited hold several, and a person who is
somewhere else in the next frame has not moved there.
"""

from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scenedetect.detectors import AdaptiveDetector
from torch import Tensor

HEIGHT = 144  # rows that pictures are compared at: sums over all pixels need no more
WINDOW = 2  # frames on either side whose change a cut's stands out of
FEW = 2 * WINDOW + 2
DETAIL = 3.0  # standard deviation in pixels at `HEIGHT` rows, below which a picture is detail
FAINT = 4.0  # of 255 levels: weaker detail is noise
# Correlation of detail: other places have 0.0, or 0.36 with one caption over both, a camera that is
# shaken 0.4. Of the median part: 0.15 behind one caption, 0.24 where a camera is shaken.
SAME_PLACE, SAME_PARTS = 0.3, 0.2
PART = 12  # pixels of a small picture, a part's side
BARE = 0.75  # of the picture's mean detail, below which a part has hardly any to compare


def shot_starts(frames: UInt8[Tensor, "F H W 3"]) -> list[int]:
    """Indices of frames that another recording begins with, 0 among them.

    PySceneDetect's adaptive detector: a change of hue, saturation and brightness that is three
    times that of the frames around, so that neither a fast pan nor a blurred dancer is a cut.
    A flash, after which all is as before, is none either, and no change of light is: a lamp that
    is switched on, a sun that someone steps in front of. Dissolves, cuts that leave the camera in
    its place or change little of the picture, and one of two cuts within two frames may not be
    found; of fewer frames than `FEW` nothing is said. (What goes through one colour is a fade,
    `fades.py`.)
    """
    if len(frames) < FEW:
        return [0]
    small = small_pictures(frames)
    cuts = _cuts(small)
    brief = [(a, b) for a, b in pairwise(cuts) if b - a <= WINDOW]
    inside = {index for span in brief for index in range(*span)}
    steady = [index for index in range(len(small)) if index not in inside]
    apart = {steady[index] for index in _cuts(small[steady])}
    flashes = {edge for a, b in brief if b not in apart for edge in (a, b)}
    elsewhere = (index for index in cuts if not same_place(small[index - 1], small[index]))
    return [0, *(index for index in elsewhere if index not in flashes)]


def small_pictures(frames: UInt8[Tensor, "F H W 3"]) -> UInt8[np.ndarray, "F h w 3"]:
    """Frames, of more than `HEIGHT` rows every n-th, blue first, as the detector takes them."""
    step = max(1, frames.shape[1] // HEIGHT)
    return frames[:, ::step, ::step].flip(-1).numpy()


def same_place(before: UInt8[np.ndarray, "H W 3"], after: UInt8[np.ndarray, "H W 3"]) -> bool:
    """Whether two small pictures have the same detail in any light.

    As a whole, and in most of the parts that have detail: captions and marks that an editor laid
    over several recordings are the same in all of them.
    """
    one, other = _detail(before), _detail(after)
    if float((one * other).sum()) < SAME_PLACE:
        return False
    size = (max(1, one.shape[1] // PART), max(1, one.shape[0] // PART))
    shared, first, second = (
        cv2.resize(product, size, interpolation=cv2.INTER_AREA)
        for product in (one * other, one**2, other**2)
    )
    shown = np.maximum(first, second) >= BARE / one.size
    alike = shared[shown] / np.sqrt(first * second)[shown].clip(1e-12)
    return float(np.median(alike)) >= SAME_PARTS


def _detail(picture: UInt8[np.ndarray, "H W 3"]) -> Float[np.ndarray, "H W"]:
    """Brightness against that around, by its contrast there; of norm 1."""
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(np.float32)
    detail = grey - cv2.GaussianBlur(grey, (0, 0), DETAIL)
    contrast = np.sqrt(cv2.GaussianBlur(detail**2, (0, 0), 2 * DETAIL) + FAINT**2)
    even = detail / contrast
    return even / max(float(np.linalg.norm(even)), 1e-6)


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
