"""The studio's cameras: a ring around the person.

Conventions. World: +Y up, the floor at y = 0, metres; camera 0 stands on +Z and trains, the others
stand on a circle around the person and test.
"""

import math
from typing import Annotated

import torch
from pydantic import Field

from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.config.section import Params, Positive
from deblur_avatar.geometry.cameras import look_at

DISTANCE = 4.0  # metres from the cameras to the middle of the studio
AIM = 0.87  # metres above the floor; what the cameras look at
FIELD = 2.12  # metres seen from top to bottom at that distance: the person fills 82 %
TRAINING_HEIGHT = 1.0  # metres
TEST_HEIGHTS = (0.7, 1.25, 1.8)  # metres, in turn


class RingParams(Params):
    """Where the ring's cameras stand."""

    training_height: Positive  # metres above the floor
    test_heights: Annotated[tuple[Positive, ...], Field(min_length=1)]  # metres, in turn
    test_degrees: float  # by which test cameras stand further round than at equal angles
    field: Positive  # metres seen from top to bottom at the ring's middle


STUDIO = RingParams(
    training_height=TRAINING_HEIGHT, test_heights=TEST_HEIGHTS, test_degrees=0.0, field=FIELD
)


def place_cameras(test_cameras: int, image_size: int, ring: RingParams = STUDIO) -> Cameras:
    """One training camera, and test cameras at equal angles between it and itself."""
    count = test_cameras + 1
    tested = [ring.test_heights[k % len(ring.test_heights)] for k in range(test_cameras)]
    heights = [ring.training_height, *tested]
    target, up = torch.tensor([0.0, AIM, 0.0]), torch.tensor([0.0, 1.0, 0.0])
    Ks, viewmats = [], []
    for index, height in enumerate(heights):
        further = math.radians(ring.test_degrees) if index > 0 else 0.0
        angle = 2 * math.pi * index / count + further
        eye = torch.tensor([DISTANCE * math.sin(angle), height, DISTANCE * math.cos(angle)])
        focal = image_size * float((eye - target).norm()) / ring.field
        middle = image_size / 2
        Ks.append(torch.tensor([[focal, 0, middle], [0, focal, middle], [0, 0, 1]]))
        viewmats.append(look_at(eye, target, up))
    return Cameras(
        Ks=torch.stack(Ks),
        viewmats=torch.stack(viewmats),
        distortion=torch.zeros(count, 5),
        sizes=torch.full((count, 2), image_size),
        names=("train", *(f"test{index}" for index in range(1, count))),
    )
