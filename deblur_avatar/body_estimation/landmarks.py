"""Landmark and matte detection (MediaPipe).

A detector is any function of the kind `PersonDetector`: MediaPipe's pose model here, keypoints
and masks of the user's own elsewhere. Landmarks are MediaPipe's 33 (BlazePose's order), in pixels
with the centre of the top left pixel at (0.5, 0.5).
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.body_estimation.part_landmarks import PartLandmarks
from deblur_avatar.body_estimation.pose_model import COMPLEXITY, PoseModel, installed_model
from deblur_avatar.body_estimation.quiet import quiet_stderr, wait_until_started

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


class Sighting(NamedTuple):
    """One person in one picture, as `Landmarks` has her."""

    points: Float[Tensor, "L 2"]
    visibility: Float[Tensor, " L"]
    world: Float[Tensor, "L 3"]
    matte: UInt8[Tensor, "H W"]


# Finds one person in consecutive frames of one still camera.
PersonDetector = Callable[[UInt8[Tensor, "F H W 3"]], Landmarks]
# The same, picture by picture.
PersonFinder = Callable[[UInt8[Tensor, "H W 3"]], Sighting | None]


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
    model = model or installed_model()
    count, height, width = frames.shape[:3]
    with pose_finder(model, follows=True) as find:
        sightings = (find(frames[i]) for i in run.progress(range(count), "landmarks and mattes"))
        return landmarks_of(sightings, (count, height, width), model)


def landmarks_of(
    sightings: Iterable[Sighting | None], size: tuple[int, int, int], model: PoseModel | None
) -> Landmarks:
    """Who was seen, frame after frame.

    Args:
        sightings: None where nobody was found.
        size: how many frames, their height and width.
        model: that saw her.
    """
    count = size[0]
    found = torch.zeros(count, dtype=torch.bool)
    points, visibility = torch.zeros(count, COUNT, 2), torch.zeros(count, COUNT)
    world = torch.zeros(count, COUNT, 3)
    mattes = torch.zeros(*size, dtype=torch.uint8)
    for index, sighting in enumerate(sightings):
        if sighting is not None:
            found[index] = True
            points[index], visibility[index], world[index], mattes[index] = sighting
    return Landmarks(found, points, visibility, mattes, world, model)


@contextmanager
def pose_finder(model: PoseModel, *, follows: bool) -> Iterator[PersonFinder]:
    """MediaPipe's pose model.

    Args:
        model: which size of it.
        follows: pictures are consecutive, and a person is looked for where she was, as long as she
            is there; otherwise anew in each.
    """
    with quiet_stderr():
        from mediapipe.python.solutions.pose import Pose  # takes a second, so only when asked

        detector = Pose(
            static_image_mode=not follows,
            model_complexity=COMPLEXITY[model],
            smooth_landmarks=False,
            enable_segmentation=True,
            smooth_segmentation=False,
        )
        wait_until_started(detector)

    def find(picture: UInt8[Tensor, "H W 3"]) -> Sighting | None:
        height, width = picture.shape[:2]
        with quiet_stderr():
            result = detector.process(np.ascontiguousarray(picture.numpy()))
        if result.pose_landmarks is None or result.segmentation_mask is None:
            return None
        marks = result.pose_landmarks.landmark
        world = torch.zeros(COUNT, 3)
        if result.pose_world_landmarks is not None:
            guess = result.pose_world_landmarks.landmark
            world = torch.tensor([(mark.x, mark.y, mark.z) for mark in guess])
        mask = torch.from_numpy(result.segmentation_mask.copy())
        return Sighting(
            torch.tensor([(mark.x * width, mark.y * height) for mark in marks]),
            torch.tensor([mark.visibility for mark in marks]),
            world,
            (mask * 255).round().clamp(0, 255).to(torch.uint8),
        )

    with detector:
        yield find
