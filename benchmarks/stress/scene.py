"""Stress scenes: a person of capsules, filmed with all truth known.

The clothes may swing in a way that no joint explains. Beside the clip stands what the `ceiling`
reaches on it: sharp frames and exact poses.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32

from benchmarks.stress.fit import FitSetup, fit_method
from benchmarks.stress.input import prepare
from benchmarks.stress.measures import mean_of_draws, measure
from benchmarks.stress.motions import stability_move
from benchmarks.stress.params import StabilitySceneParams
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.bodies.capsule import capsule_body
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.sources.studio.motion import Moves
from deblur_avatar.sources.studio.person import Person
from deblur_avatar.sources.studio.source import film, set_scene

SWINGS = 5  # of the clothes while the person turns once
WAIST, HEM = 0.05, -0.45  # metres above the pelvis: where the swing begins and is widest


@dataclass(frozen=True)
class SwingingPerson(Person):
    """Clothes below the waist swing sideways, as a pendulum would."""

    reach: float  # metres to either side

    def posed(self, moves: Moves) -> Iterator[Float32[np.ndarray, "P 3"]]:
        """Vertices at each instant; the swing's phase is the person's angle to the camera."""
        height = self.drape.vertices[:, 1]
        share = np.clip((WAIST - height) / (WAIST - HEM), 0, 1) * (self.drape.slack > 0)
        turned = axis_angle_to_matrix(moves.global_orient)
        yaw = torch.atan2(turned[:, 0, 2], turned[:, 0, 0])
        sideways = turned[:, :, 0] * self.reach * torch.sin(SWINGS * yaw)[:, None]
        instants = zip(super().posed(moves), sideways.numpy(), strict=True)
        for vertices, offset in instants:
            yield (vertices + share[:, None] * offset).astype(np.float32)


def film_scene(
    params: StabilitySceneParams, generator: torch.Generator
) -> tuple[Body, Clip, Reference]:
    """Film one scene of the suite; the same every time for the same generator."""
    body = capsule_body()
    scene = set_scene(params.clip.model_copy(update={"motion": "turn"}), body)
    seconds = scene.held_out_from / params.clip.fps
    if params.cloth_m > 0:
        parts = {
            field.name: getattr(scene.person, field.name) for field in dataclasses.fields(Person)
        }
        scene = dataclasses.replace(scene, person=SwingingPerson(**parts, reach=params.cloth_m))
    scene = dataclasses.replace(
        scene,
        true=stability_move(params.clip.motion, scene.timestamps, seconds),
        fine=stability_move(params.clip.motion, scene.subtimes, seconds),
    )
    return body, *film(scene, generator)


def measure_ceiling(
    clip: Clip, reference: Reference, body: Body, setup: FitSetup, draws: int
) -> dict[str, Any]:
    """What sharp frames and exact poses give on this scene: the upper bound of its modes.

    Means over so many draws.
    """
    prepared = prepare(
        clip, body, {}, setup.schedule.image_height, setup.validation_stride, setup.seed
    )
    assert prepared.exact is not None  # the studio knows all
    fits = (fit_method(prepared.exact, setup, draw=draw) for draw in range(draws))
    measured = [measure(prepared.blurred, reference, fitted, setup.device) for fitted in fits]
    numbers = mean_of_draws([one.numbers for one in measured])
    # Every mode depends on these, so no clock has a say.
    return {name: number for name, number in numbers.items() if name != "seconds"}
