"""Improvised motion: every joint swings at rates of its own, no two draws alike.

Conventions. As `motion.py`. For what learns from motion at large (`deblurring_takes.py`): no scene
is filmed so, and nothing of a scene's motion is in it.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.sources.studio.motion import STANDING, Motion, Moves

WAVES = 2  # of each angle
RATES = 0.4, 2.0  # of a wave, a second; drawn evenly by their logarithm
SPIN = 0.8  # turns of the whole body a second, at most, either way
SWAY, SWAY_RATES = 0.06, (0.4, 1.5)  # metres, standard deviation along each axis; a second
# How far joints swing, radians, standard deviation of each of their angles; others hardly do.
SWING = {
    "hip": 0.28, "knee": 0.3, "ankle": 0.15, "spine1": 0.08, "spine2": 0.08, "spine3": 0.08,
    "neck": 0.12, "head": 0.15, "collar": 0.08, "shoulder": 0.5, "elbow": 0.4, "wrist": 0.25,
}  # fmt: skip
STILL = 0.02  # radians, of all others
# Means of angles about x, y and z of the left side, and how far they are off them, radians.
POSTURE = {"knee": (0.45, 0.0, 0.0), "shoulder": (0.0, 0.0, -0.7), "elbow": (0.0, -0.6, 0.0)}
POSTURE_DEVIATION = 0.2
MIRRORED = (1.0, -1.0, -1.0)  # the right side's angles are the left side's times this


def improvise(generator: torch.Generator) -> Motion:
    """Draw a motion: sums of sines about a standing posture, on the spot."""
    swing, posture = _swing(), _posture()
    count = len(SMPL_JOINT_NAMES)
    posture = posture + POSTURE_DEVIATION * swing / max(SWING.values()) * _normal(generator, count)
    swings = swing[..., None] * _normal(generator, count, 3, WAVES) / WAVES**0.5
    rates, phases = _rates(RATES, generator, count), _phases(generator, count)
    sways = SWAY * _normal(generator, 1, 3, WAVES)
    sway_rates, sway_phases = _rates(SWAY_RATES, generator, 1), _phases(generator, 1)
    heading, spin = (_even(generator, 2) * 2 - 1).tolist()

    def motion(times: Float[Tensor, " M"], training_seconds: float) -> Moves:
        seconds = times.double()[:, None, None, None]
        angles = posture + (swings * (2 * math.pi * rates * seconds + phases).sin()).sum(-1)
        place = (sways * (2 * math.pi * sway_rates * seconds + sway_phases).sin()).sum(-1)[:, 0]
        turned = math.pi * heading + 2 * math.pi * SPIN * spin * times.double()
        orient = torch.stack([0 * turned, turned, 0 * turned], -1)
        return Moves(orient, angles[:, 1:], place + place.new_tensor([0.0, STANDING, 0.0]))

    return motion


def _swing() -> Float[Tensor, "J 3"]:
    rows = [SWING.get(_side_free(name), STILL) for name in SMPL_JOINT_NAMES]
    return torch.tensor(rows, dtype=torch.float64)[:, None].expand(-1, 3)


def _posture() -> Float[Tensor, "J 3"]:
    rows = torch.tensor(
        [POSTURE.get(_side_free(name), (0.0, 0.0, 0.0)) for name in SMPL_JOINT_NAMES],
        dtype=torch.float64,
    )
    right = torch.tensor([name.startswith("right_") for name in SMPL_JOINT_NAMES])
    return torch.where(right[:, None], rows * rows.new_tensor(MIRRORED), rows)


def _side_free(name: str) -> str:
    return name.removeprefix("left_").removeprefix("right_")


def _normal(generator: torch.Generator, joints: int, *shape: int) -> Tensor:
    return torch.randn(joints, *(shape or (3,)), generator=generator, dtype=torch.float64)


def _even(generator: torch.Generator, *shape: int) -> Tensor:
    return torch.rand(*shape, generator=generator, dtype=torch.float64)


def _rates(
    between: tuple[float, float], generator: torch.Generator, joints: int
) -> Float[Tensor, "J 3 W"]:
    low, high = (math.log(rate) for rate in between)
    return (low + (high - low) * _even(generator, joints, 3, WAVES)).exp()


def _phases(generator: torch.Generator, joints: int) -> Float[Tensor, "J 3 W"]:
    return 2 * math.pi * _even(generator, joints, 3, WAVES)
