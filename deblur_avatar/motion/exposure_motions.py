"""Other ways to join the poses of one exposure, each a row of the ablations.

Conventions. Those of `motion`: every frame has unknowns of its own, `u` in [0, 1] is time within
the exposure, the middle stays at the given pose at first.
"""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import axis_angle_to_quat, quat_multiply
from deblur_avatar.geometry.splines import spline_points, spline_quats
from deblur_avatar.motion.trajectory import (
    Instants,
    PairMotion,
    Trajectory,
    stacked_axis_angle,
)

KNOTS = 4
LEARNED_UNITS = 256  # the authors' leftover network
LEARNED_SCALE = 0.1  # radians and metres for an output of 1


class CubicMotion(Trajectory):
    """Four knots a frame, joined by a cumulative cubic B-spline.

    The paper's ablation, done as its text says: the authors' code calls a straight line through two
    knots cubic. The curve is the segment between the two inner knots.

    Source: BAD-Gaussians (Zhao et al., ECCV 2024) for the form, Kim et al. 1995 for the rotations.
    """

    kind = "cubic"

    def __init__(
        self, poses: Poses, u: Tensor, start_noise: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.register_buffer("u", u, persistent=False)
        given = stacked_axis_angle(poses)
        noise = torch.randn(given.shape, generator=generator, device=given.device) * start_noise
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


class LearnedMotion(PairMotion):
    """A start and an end pose a frame, joined as one network for all frames has learned to.

    The paper names such an ablation and says no more. Here the network sees both poses and u, and
    turns and shifts the pair's pose by an amount that vanishes at either end; nothing at first.
    """

    kind = "learned"

    def __init__(
        self, poses: Poses, u: Tensor, start_noise: float, generator: torch.Generator
    ) -> None:
        super().__init__(poses, u, start_noise, generator)
        joints = self.start.shape[1]
        self.bend = nn.Sequential(
            nn.Linear(2 * 3 * joints + 1, LEARNED_UNITS), nn.LeakyReLU(),
            nn.Linear(LEARNED_UNITS, LEARNED_UNITS), nn.LeakyReLU(),
        )  # fmt: skip
        self.amount = nn.Linear(LEARNED_UNITS, 3 * joints + 3)
        nn.init.zeros_(self.amount.weight)
        nn.init.zeros_(self.amount.bias)

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """The pair's poses, bent."""
        straight = super().at(frame, u)
        times = torch.cat([u, u.new_tensor([0.5])])[:, None]
        ends = torch.cat([self.start[frame].flatten(), self.end[frame].flatten()])
        seen = torch.cat([ends.expand(len(times), -1), times], dim=1)
        change = LEARNED_SCALE * 4 * times * (1 - times) * self.amount(self.bend(seen))
        turns = axis_angle_to_quat(change[:, :-3].unflatten(1, (-1, 3)))
        quats = torch.cat([straight.quats, straight.centre_quats[None]])
        transl = torch.cat([straight.transl, straight.centre_transl[None]]) + change[:, -3:]
        bent = quat_multiply(quats, turns)
        return Instants(bent[:-1], transl[:-1], bent[-1], transl[-1])


class ReleasedMotion(PairMotion):
    """The authors' released code: the noise is the start's alone, the middle is the given pose.

    What is drawn sharp, and scored, is the pose that was given, which never moves.

    Source: facts of the code (xianrui-luo/deblur_avatar), `PoseInterpolation` and `render_pose`.
    """

    kind = "released"
    given: Tensor
    given_transl: Tensor

    def __init__(
        self, poses: Poses, u: Tensor, start_noise: float, generator: torch.Generator
    ) -> None:
        super().__init__(poses, u, 0.0, generator)
        self.register_buffer("given", stacked_axis_angle(poses))
        self.register_buffer("given_transl", poses.transl.clone())
        noise = torch.randn(self.start.shape, generator=generator, device=self.start.device)
        noise[:, 0] = 0
        with torch.no_grad():
            self.start.add_(start_noise * noise)

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """Virtual poses between start and end, and the given pose as the middle."""
        moving = super().at(frame, u)
        still = axis_angle_to_quat(self.given[frame])
        return replace(moving, centre_quats=still, centre_transl=self.given_transl[frame])


EXPOSURE_MOTIONS = {
    kind.kind: kind for kind in (PairMotion, CubicMotion, LearnedMotion, ReleasedMotion)
}
