"""Hand-held camera: its way past the person, a smooth function of time.

Conventions. The studio's world, metres, seconds. It sways and shakes as sums of sines of random
phase, turns slowly past the person (pan), and may walk sideways with a bob at every step while it
looks at her.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.config.section import NonNegative, Params
from deblur_avatar.geometry.cameras import look_at
from deblur_avatar.geometry.rotations import axis_angle_to_matrix

SWAY_HZ = (0.23, 0.41, 0.87)  # of a body that stands
SHAKE_HZ = (0.9, 2.3, 5.1)  # of hands
STEP_HZ, BOB = 1.8, 0.012  # steps a second; metres up and down while walking
UP = (0.0, 1.0, 0.0)


class HandHeldParams(Params):
    """How unsteadily the camera is held."""

    sway_mm: NonNegative  # root mean square of its place
    shake_degrees: NonNegative  # root mean square of its direction
    pan_degrees: NonNegative  # turned over the clip, evenly, the person in the middle half way
    walk_m: NonNegative  # walked sideways over the clip, evenly


@dataclass(frozen=True)
class CameraPath:
    """Where a camera is at any time of a clip."""

    eye: tuple[float, float, float]  # metres; of a tripod
    target: tuple[float, float, float]
    seconds: float  # of the clip
    params: HandHeldParams | None  # None: a tripod
    phases: Float[Tensor, "6 3"]  # radians; of sway and shake, of three sines each

    def viewmats(self, times: Float[Tensor, " M"]) -> Float[Tensor, "M 4 4"]:
        """World to camera, at some times."""
        return torch.stack([self._viewmat(float(time)) for time in times])

    def _viewmat(self, time: float) -> Float[Tensor, "4 4"]:
        eye = torch.tensor(self.eye, dtype=torch.float64)
        target, up = torch.tensor(self.target).double(), torch.tensor(UP).double()
        if self.params is None:
            return look_at(eye, target, up)
        share = time / self.seconds - 0.5
        eye = eye + self.params.sway_mm / 1000 * self._unsteady(time, SWAY_HZ, 0)
        if self.params.walk_m:
            eye[0] += self.params.walk_m * share
            eye[1] += BOB * math.sin(2 * math.pi * STEP_HZ * time)
        turn = math.radians(self.params.shake_degrees) * self._unsteady(time, SHAKE_HZ, 3)
        turn[1] += math.radians(self.params.pan_degrees) * share
        viewmat = torch.eye(4, dtype=torch.float64)
        viewmat[:3, :3] = axis_angle_to_matrix(turn)
        return viewmat @ look_at(eye, target, up)

    def _unsteady(
        self, time: float, rates: tuple[float, float, float], row: int
    ) -> Float[Tensor, " 3"]:
        """Along each axis, of root mean square 1 over all axes together."""
        sines = [
            torch.sin(2 * math.pi * rate * time + self.phases[row + index])
            for index, rate in enumerate(rates)
        ]
        return torch.stack(sines).sum(0) * (2 / 9) ** 0.5


def camera_path(
    eye: tuple[float, float, float],
    target: tuple[float, float, float],
    seconds: float,
    params: HandHeldParams | None,
    generator: torch.Generator,
) -> CameraPath:
    """Draw the phases of one clip's camera."""
    phases = 2 * math.pi * torch.rand(6, 3, generator=generator, dtype=torch.float64)
    return CameraPath(eye, target, seconds, params, phases)
