"""Features of the background, and which of them two frames share.

SIFT (Lowe 2004) at most `MATCHED_WIDTH` pixels wide; places are in pixels of the picture at that
size. A frame's features are found once, and those on the person left out for each of its mattes.
"""

from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.imaging.camera_motion import background_mask
from deblur_avatar.run import in_threads

MATCHED_WIDTH = 960  # pixels; larger frames are matched at this size
FEATURES = 2000  # a frame: a textured wall has more, a bare one fewer
RATIO = 0.75  # of the best match's distance to the second best (Lowe 2004)
FEWEST = 30  # features or matches without which two frames tell nothing


class Features(NamedTuple):
    """Where features are in one frame, and what they look like."""

    places: Float[np.ndarray, "N 2"]
    descriptors: UInt8[np.ndarray, "N 128"]


def matched_scale(height: int, width: int) -> float:
    """How much smaller frames are when they are matched."""
    return min(1.0, MATCHED_WIDTH / max(width, height))


class FrameFeatures:
    """Features of one camera's frames, found when they are first asked for."""

    def __init__(self, frames: UInt8[Tensor, "F H W 3"]) -> None:
        self._frames = frames

    @cached_property
    def _found(self) -> list[Features]:
        return in_threads(_features, self._frames)

    def beside(self, mattes: UInt8[Tensor, "F H W"]) -> list[Features]:
        """Those of each frame that are surely not on the person."""
        return in_threads(_beside, self._found, mattes)


def _features(frame: UInt8[Tensor, "H W 3"]) -> Features:
    detector: cv2.Feature2D = cv2.SIFT_create(FEATURES)  # type: ignore[attr-defined]
    grey: np.ndarray = cv2.cvtColor(frame.numpy(), cv2.COLOR_RGB2GRAY)
    scale = matched_scale(*grey.shape)
    if scale < 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    points, descriptors = detector.detectAndCompute(grey, None)
    if descriptors is None:
        descriptors = np.zeros((0, 128))
    places = np.array([point.pt for point in points], np.float32).reshape(-1, 2)
    return Features(places, descriptors.astype(np.uint8))  # SIFT's are whole numbers to 255


def _beside(found: Features, matte: UInt8[Tensor, "H W"]) -> Features:
    mask: np.ndarray = background_mask(matte).numpy().astype(np.uint8)
    scale = matched_scale(*mask.shape)
    if scale < 1:
        mask = cv2.resize(mask, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    column, row = (found.places + 0.5).astype(int).T
    bare = mask[row, column] > 0
    return Features(found.places[bare], found.descriptors[bare])


def matches(
    key: Features, other: Features
) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, "N 2"]] | None:
    """Places of the same features in two frames, the other's first; None if they are too few."""
    if min(len(key.places), len(other.places)) < FEWEST:
        return None
    described, known = (found.descriptors.astype(np.float32) for found in (other, key))
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(described, known, k=2)
    good = [pair[0] for pair in pairs if pair[0].distance < RATIO * pair[-1].distance]
    if len(good) < FEWEST:
        return None
    return (
        other.places[[match.queryIdx for match in good]],
        key.places[[match.trainIdx for match in good]],
    )
