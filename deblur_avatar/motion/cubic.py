"""Cubic B-spline trajectory of each exposure: four knots a frame (an ablation)."""

from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import axis_angle_to_quat
from deblur_avatar.geometry.splines import spline_points, spline_quats
from deblur_avatar.motion.per_frame import PerFrameParams, PerFrameTrajectory
from deblur_avatar.motion.trajectory import Instants, MotionParams

KNOTS = 4  # not a parameter: what one segment of a cubic B-spline has


class CubicParams(PerFrameParams):
    """Four knots a frame."""

    kind: Literal["cubic"]


class CubicMotion(PerFrameTrajectory):
    """Four knots a frame, joined by a cumulative cubic B-spline.

    The paper's ablation, done as its text says: the authors' code calls a straight line through two
    knots cubic. The curve is the segment between the two inner knots.

    Source: BAD-Gaussians (Zhao et al., ECCV 2024) for the form, Kim et al. 1995 for the rotations.
    """

    kind = "cubic"
    Params: ClassVar[type[MotionParams]] = CubicParams

    def __init__(
        self, poses: Poses, u: Tensor, start_noise: float, generator: torch.Generator
    ) -> None:
        super().__init__(poses, u, start_noise, generator)
        given = poses.axis_angle
        noise = torch.randn(given.shape, generator=generator) * start_noise
        noise[:, 0] = 0  # as of a pair
        # On a line, so that the curve starts half the noise ahead and ends half of it behind.
        along = torch.tensor([1.5, 0.5, -0.5, -1.5]).to(given)[:, None, None]
        self.knots = nn.Parameter(given[:, None] + along * noise[:, None])
        self.transl = nn.Parameter(poses.transl[:, None].repeat(1, KNOTS, 1))

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """The curve between the inner knots."""
        times = 1 + torch.cat([u, u.new_tensor([0.5])])
        quats = spline_quats(axis_angle_to_quat(self.knots[frame]), times)
        transl = spline_points(self.transl[frame], times)
        return Instants(quats[:-1], transl[:-1], quats[-1], transl[-1])

    def parameter_groups(self) -> dict[str, list[tuple[str, Tensor]]]:
        """Rotations and translations of the knots."""
        return {"poses": [("knots", self.knots)], "transl": [("transl", self.transl)]}
