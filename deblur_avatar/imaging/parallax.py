"""Parallax: whether near and far move apart in the background of a camera that moves.

A camera that turns, zooms or drifts in one place, or sees one plane, moves its whole background by
one homography from frame to frame. One that travels past things moves them by an epipolar geometry
that no homography explains, and only such frames tell where cameras stood (Hartley and Zisserman
2004, 11.9.2; the choice between both models by their inliers: Schönberger and Frahm 2016, 4.1).
"""

from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.imaging.background_features import FEWEST, FrameFeatures, matches

SAMPLES = 5  # frames, each compared with each
HOMOGRAPHY_PIXELS = 2.0  # from where a homography puts a feature, still an inlier
EPIPOLAR_PIXELS = 1.0  # from its epipolar line: half as far, since a line leaves a feature free
CONFIDENCE, DRAWS = 0.999, 2000  # of RANSAC
# Homographies have 0.97 to 1.07 times the inliers of the epipolar geometry where the camera
# turned or drifted (seven clips), and in some pair of frames at most 0.88 where it walked (three).
EXPLAINED = 0.95


def has_parallax(frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"]) -> bool:
    """Whether any two of a few frames have a background that no homography explains.

    Returns:
        True also where too little can be matched to tell: nothing is ruled out by it.
    """
    chosen = evenly_spaced(range(len(frames)), SAMPLES)
    found = FrameFeatures(frames[chosen]).beside(mattes[chosen])
    unmatched = False  # of neighbours
    for (before, key), (after, other) in combinations(enumerate(found), 2):
        pair = matches(key, other)
        if pair is None:
            unmatched |= after == before + 1
        elif not explained_by_a_homography(*pair):
            return True
    return unmatched


def explained_by_a_homography(
    source: Float[np.ndarray, "N 2"], target: Float[np.ndarray, "N 2"]
) -> bool:
    """Whether a homography has as many inliers as an epipolar geometry, or nearly; or neither any.

    Args:
        source: places of features in one frame, pixels.
        target: of the same in another.
    """
    _, plane = cv2.findHomography(source, target, cv2.RANSAC, HOMOGRAPHY_PIXELS)
    _, epipolar = cv2.findFundamentalMat(
        source, target, cv2.FM_RANSAC, EPIPOLAR_PIXELS, CONFIDENCE, DRAWS
    )
    inliers = [0 if mask is None else int(np.asarray(mask).sum()) for mask in (plane, epipolar)]
    return inliers[1] < FEWEST or inliers[0] >= EXPLAINED * inliers[1]
