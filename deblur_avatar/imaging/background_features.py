"""Features of the background, and which of them two frames share.

SIFT (Lowe 2004) on what is surely not the person, at most `MATCHED_WIDTH` pixels wide; places are
in pixels of the picture at that size.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.imaging.camera_motion import background_mask

MATCHED_WIDTH = 960  # pixels; larger frames are matched at this size
FEATURES = 2000  # a frame: a textured wall has more, a bare one fewer
RATIO = 0.75  # of the best match's distance to the second best (Lowe 2004)
FEWEST = 30  # features or matches without which two frames tell nothing


class Features(NamedTuple):
    """Where features are in one frame, and what they look like."""

    places: Float[np.ndarray, "N 2"]
    descriptors: Float[np.ndarray, "N 128"] | None  # None without any


def matched_scale(height: int, width: int) -> float:
    """How much smaller frames are when they are matched."""
    return min(1.0, MATCHED_WIDTH / max(width, height))


def background_features(
    frame: UInt8[Tensor, "H W 3"], matte: UInt8[Tensor, "H W"], detector: cv2.Feature2D
) -> Features:
    """Features of what is not the person, by a detector that `sift()` made."""
    grey: np.ndarray = cv2.cvtColor(frame.numpy(), cv2.COLOR_RGB2GRAY)
    mask: np.ndarray = background_mask(matte).numpy().astype(np.uint8)
    scale = matched_scale(*grey.shape)
    if scale < 1:
        grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        mask = cv2.resize(mask, (grey.shape[1], grey.shape[0]), interpolation=cv2.INTER_NEAREST)
    points, descriptors = detector.detectAndCompute(grey, mask)
    return Features(
        np.array([point.pt for point in points], np.float32).reshape(-1, 2), descriptors
    )


def sift() -> cv2.Feature2D:
    """What finds features."""
    detector: cv2.Feature2D = cv2.SIFT_create(FEATURES)  # type: ignore[attr-defined]
    return detector


def matches(
    key: Features, other: Features
) -> tuple[Float[np.ndarray, "N 2"], Float[np.ndarray, "N 2"]] | None:
    """Places of the same features in two frames, the other's first; None if they are too few."""
    if key.descriptors is None or other.descriptors is None:
        return None
    if min(len(key.places), len(other.places)) < FEWEST:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(other.descriptors, key.descriptors, k=2)
    good = [pair[0] for pair in pairs if pair[0].distance < RATIO * pair[-1].distance]
    if len(good) < FEWEST:
        return None
    return (
        other.places[[match.queryIdx for match in good]],
        key.places[[match.trainIdx for match in good]],
    )
