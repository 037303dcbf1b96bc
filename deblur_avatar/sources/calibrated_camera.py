"""One camera as a calibration file describes it, in our conventions."""

from typing import NamedTuple

import numpy as np


class CalibratedCamera(NamedTuple):
    """Pixels with the centre of the top left one at (0.5, 0.5), OpenCV axes, metres."""

    name: str
    K: np.ndarray  # [3,3]
    viewmat: np.ndarray  # [4,4], world to camera
    distortion: np.ndarray  # [5], OpenCV's k1, k2, p1, p2, k3
    size: tuple[float, float]  # width, height


def rigid(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """The [4,4] matrix of a rotation and what follows it."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation
    return matrix
