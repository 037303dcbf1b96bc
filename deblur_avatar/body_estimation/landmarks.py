"""Landmark and matte detection (MediaPipe).

A detector is any function of the kind `PersonDetector`: MediaPipe's pose model here, keypoints
and masks of the user's own elsewhere. Landmarks are MediaPipe's 33 (BlazePose's order), in pixels
with the centre of the top left pixel at (0.5, 0.5).
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.body_estimation.part_landmarks import PartLandmarks
from deblur_avatar.body_estimation.pose_model import COMPLEXITY, PoseModel, installed_model
from deblur_avatar.body_estimation.quiet import quiet_stderr, wait_until_started

logger = logging.getLogger(__name__)

COUNT = 33  # landmarks of MediaPipe's pose model


@dataclass(frozen=True)
class Landmarks:
    """One person in F frames of one camera; rows of frames where no one was found are zero."""

    found: Bool[Tensor, " F"]
    points: Float[Tensor, "F L 2"]  # pixels
    visibility: Float[Tensor, "F L"]  # in [0, 1], how sure the detector is
    mattes: UInt8[Tensor, "F H W"]  # coverage
    world: Float[Tensor, "F L 3"] | None = None  # a guess: metres about the hips, the camera's axes
    model: PoseModel | None = None  # of MediaPipe's; None: another detector
    parts: PartLandmarks | None = None  # hands and face, where they were looked for


# Finds one person in consecutive frames of one still camera.
PersonDetector = Callable[[UInt8[Tensor, "F H W 3"]], Landmarks]


def detect_with_mediapipe(
    frames: UInt8[Tensor, "F H W 3"], model: PoseModel | None = None
) -> Landmarks:
    """Find the most conspicuous person with MediaPipe's pose model and follow them.

    The mattes are the pose model's own segmentation: unlike the selfie model's they keep to the
    person followed. Neither landmarks nor mattes are smoothed over time.

    Args:
        frames: consecutive, of one camera.
        model: None for the largest that is installed; `Landmarks.model` says which it was.
    """
    count, height, width = frames.shape[:3]
    found = torch.zeros(count, dtype=torch.bool)
    points, visibility = torch.zeros(count, COUNT, 2), torch.zeros(count, COUNT)
    world = torch.zeros(count, COUNT, 3)
    mattes = torch.zeros(count, height, width, dtype=torch.uint8)
    model = model or installed_model()
    with quiet_stderr():
        from mediapipe.python.solutions.pose import Pose  # takes a second, so only when asked

        detector = Pose(
            model_complexity=COMPLEXITY[model],
            smooth_landmarks=False,
            enable_segmentation=True,
            smooth_segmentation=False,
        )
        wait_until_started(detector)
    with detector:
        for index in run.progress(range(count), "landmarks and mattes"):
            with quiet_stderr():
                result = detector.process(np.ascontiguousarray(frames[index].numpy()))
            if result.pose_landmarks is None or result.segmentation_mask is None:
                continue
            marks = result.pose_landmarks.landmark
            found[index] = True
            points[index] = torch.tensor([(mark.x * width, mark.y * height) for mark in marks])
            visibility[index] = torch.tensor([mark.visibility for mark in marks])
            if result.pose_world_landmarks is not None:
                guess = result.pose_world_landmarks.landmark
                world[index] = torch.tensor([(mark.x, mark.y, mark.z) for mark in guess])
            mask = torch.from_numpy(result.segmentation_mask.copy())
            mattes[index] = (mask * 255).round().clamp(0, 255).to(torch.uint8)
    return Landmarks(found, points, visibility, mattes, world, model)
