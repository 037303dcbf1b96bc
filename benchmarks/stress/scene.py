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
from benchmarks.stress.measures import CLOCKS, mean_of_draws, measure
from benchmarks.stress.motions import stability_move
from benchmarks.stress.params import StabilitySceneParams
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.bodies.capsule import capsule_body
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.sources.studio.motion import Moves
from deblur_avatar.sources.studio.person import Person
from deblur_avatar.sources.studio.source import film, set_scene
from deblur_avatar.training.params import RecipeParams

SWINGS = 5  # of the clothes while the person turns once
LEFT_SHOULDER = SMPL_JOINT_NAMES.index("left_shoulder") - 1  # of the body's joints
WAIST, HEM = 0.05, -0.45  # metres above the pelvis: where the swing begins and is widest


@dataclass(frozen=True)
class SwingingPerson(Person):
    """Clothes below the waist move sideways, though no joint there does.

    Attributes:
        swing: metres to either side, as a pendulum would.
        pull: metres to either side, as if they hung on the left arm: the pose decides it.
    """

    swing: float
    pull: float

    def posed(self, moves: Moves) -> Iterator[Float32[np.ndarray, "P 3"]]:
        """Vertices at each instant.

        The swing's phase is the person's angle to the camera, the pull that of the raised arm.
        """
        height = self.drape.vertices[:, 1]
        share = np.clip((WAIST - height) / (WAIST - HEM), 0, 1) * (self.drape.slack > 0)
        turned = axis_angle_to_matrix(moves.global_orient)
        yaw = torch.atan2(turned[:, 0, 2], turned[:, 0, 0])
        raised = torch.sin(2 * torch.pi * moves.body_pose[:, LEFT_SHOULDER].norm(dim=-1))
        reach = self.swing * torch.sin(SWINGS * yaw) + self.pull * raised
        sideways = turned[:, :, 0] * reach[:, None]
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
    if params.cloth_m > 0 or params.pulled_m > 0:
        parts = {
            field.name: getattr(scene.person, field.name) for field in dataclasses.fields(Person)
        }
        person = SwingingPerson(**parts, swing=params.cloth_m, pull=params.pulled_m)
        scene = dataclasses.replace(scene, person=person)
    scene = dataclasses.replace(
        scene,
        true=stability_move(params.clip.motion, scene.timestamps, seconds),
        fine=stability_move(params.clip.motion, scene.subtimes, seconds),
    )
    return body, *film(scene, generator)


def measure_ceilings(
    clip: Clip, reference: Reference, body: Body, setup: FitSetup, networks: bool
) -> dict[str, Any]:
    """What sharp frames and exact poses give on this scene: the upper bound of its modes.

    Returns:
        Means over draws, of an avatar without networks (`plain`) and, where asked for, of one with
        them (`networks`).
    """
    prepared = prepare(
        clip, body, {}, setup.schedule.image_height, setup.validation_stride, setup.seed
    )

    def ceiling(recipe: RecipeParams) -> dict[str, Any]:
        assert prepared.exact is not None  # the studio knows all
        fits = [fit_method(prepared.exact, setup, recipe, draw=n) for n in range(setup.draws)]
        measured = [measure(prepared.blurred, reference, fitted, setup.device) for fitted in fits]
        numbers = mean_of_draws([one.numbers for one in measured])
        # Every mode depends on these, so no clock has a say.
        return {name: number for name, number in numbers.items() if name not in CLOCKS}

    ceilings = {"plain": ceiling(setup.plain)}
    if networks:
        assert setup.networks is not None  # the file of parameters lists `ceiling`
        ceilings["networks"] = ceiling(setup.networks)
    return ceilings
