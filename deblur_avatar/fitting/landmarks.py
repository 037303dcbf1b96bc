"""Where a person's landmarks are in a picture, and which pixels the person fills.

A detector is any function of the kind `PersonDetector`: MediaPipe's pose model here, keypoints
and masks of the user's own elsewhere. Landmarks are MediaPipe's 33 (BlazePose's order), in pixels
with the centre of the top left pixel at (0.5, 0.5).
"""

from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Bool, Float, UInt8
from torch import Tensor


@dataclass(frozen=True)
class Landmarks:
    """One person in F frames of one camera; rows of frames where no one was found are zero."""

    found: Bool[Tensor, " F"]
    points: Float[Tensor, "F L 2"]  # pixels
    visibility: Float[Tensor, "F L"]  # in [0, 1], how sure the detector is
    mattes: UInt8[Tensor, "F H W"]  # coverage


# Finds one person in consecutive frames of one still camera.
PersonDetector = Callable[[UInt8[Tensor, "F H W 3"]], Landmarks]


def detect_with_mediapipe(frames: UInt8[Tensor, "F H W 3"]) -> Landmarks:
    raise NotImplementedError
