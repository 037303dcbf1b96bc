"""One smooth trajectory for the whole clip, of which every exposure is a piece.

Conventions. Knots stand evenly in time; `middles` are the frames' middles in units of the knots'
spacing. F frames, K knots, J joints, S instants. Penalties weigh a shift against a joint's turn by
LEVER.
"""

import math

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.geometry.splines import (
    fit_knots,
    spline_points,
    spline_quats,
)
from deblur_avatar.motion.trajectory import (
    Instants,
    Trajectory,
    instants,
    stacked_axis_angle,
)

LEVER = 0.3  # metres that a joint's turn of one radian moves what hangs on it, roughly
WIDEST = math.log(4)  # an estimated shutter stays within a quarter and four times the first guess


class ClipMotion(Trajectory):
    """A cubic B-spline of every joint's rotation and of the translation.

    Neighbouring frames say which way a limb moves, exposures may overlap or leave gaps, and frames
    that were never fitted lie on the curve too.

    Source: design of this project, after continuous-time trajectories (BAD-Gaussians; Casual3DHDR).
    """

    kind = "clip"
    middles: Tensor
    guess: Tensor
    taken: Tensor
    halfway: Tensor | None
    first_axis_angle: Tensor
    first_transl: Tensor

    def __init__(
        self,
        u: Float[Tensor, " S"],
        middles: Float[Tensor, " F"],
        guess: Float[Tensor, ""],
        axis_angle: Float[Tensor, "K J 3"],
        transl: Float[Tensor, "K 3"],
        *,
        estimate_shutter: bool,
    ) -> None:
        """Take knots, and how long the shutter was open, in units of the knots' spacing."""
        super().__init__()
        self.register_buffer("u", u, persistent=False)
        self.register_buffer("middles", middles)
        self.register_buffer("guess", guess)
        self.register_buffer("taken", torch.full(middles.shape, len(u)))
        self.register_buffer("first_axis_angle", axis_angle.clone())
        self.register_buffer("first_transl", transl.clone())
        self.axis_angle = nn.Parameter(axis_angle)
        self.transl = nn.Parameter(transl)
        self.log_shutter = nn.Parameter(guess.new_zeros(()), requires_grad=estimate_shutter)
        self.register_buffer("halfway", guess.new_zeros(()) if estimate_shutter else None)

    @classmethod
    def near(
        cls,
        poses: Poses,
        u: Float[Tensor, " S"],
        timestamps: Float[Tensor, " F"],
        exposure: float,
        knot_spacing: float,
        smoothness: float,
        *,
        estimate_shutter: bool = False,
    ) -> "ClipMotion":
        """The smoothest curve near given poses; exposure and knot spacing in seconds."""
        reach = exposure / 2 * (math.exp(WIDEST) if estimate_shutter else 1)
        first = float(timestamps[0]) - reach
        span = float(timestamps[-1]) + reach - first
        count = max(round(span / knot_spacing) + 1, 2)
        spacing = span / (count - 1)
        middles = (timestamps - first) / spacing
        quats = continuous(axis_angle_to_quat(stacked_axis_angle(poses)))
        knots = fit_knots(quats.flatten(1), middles, count, smoothness).unflatten(1, (-1, 4))
        axis_angle = quat_to_axis_angle(nn.functional.normalize(knots, dim=-1))
        transl = fit_knots(poses.transl, middles, count, smoothness)
        guess = torch.tensor(exposure / spacing)
        return cls(u, middles, guess, axis_angle, transl, estimate_shutter=estimate_shutter)

    @classmethod
    def restored(cls, u: Float[Tensor, " S"], parameters: dict[str, Tensor]) -> "ClipMotion":
        """The trajectory that `to_artifact` saved; its shutter is settled."""
        names = ("middles", "guess", "axis_angle", "transl")
        # Clones: fitting works in place, and an artifact never changes.
        motion = cls(u, *(parameters[name].clone() for name in names), estimate_shutter=False)
        motion.load_state_dict({name: parameters[name] for name in motion.state_dict()})
        return motion

    @property
    def shutter(self) -> Float[Tensor, ""]:
        """How long the shutter was open, in units of the knots' spacing."""
        return self.guess * self.log_shutter.clamp(-WIDEST, WIDEST).exp()

    def forward(self, frame: int) -> Instants:
        """The piece of the trajectory that one exposure sees, at as many instants as it needs."""
        return self.at(frame, instants(int(self.taken[frame]), "midpoints").to(self.u))

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """The piece of the trajectory that one exposure sees."""
        times = self.middles[frame] + (torch.cat([u, u.new_tensor([0.5])]) - 0.5) * self.shutter
        quats = spline_quats(axis_angle_to_quat(self.axis_angle), times)
        transl = spline_points(self.transl, times)
        return Instants(quats[:-1], transl[:-1], quats[-1], transl[-1])

    def first(self, frame: int) -> Instants:
        """The middle of one exposure as it was before fitting."""
        time = self.middles[frame : frame + 1]
        quats = spline_quats(axis_angle_to_quat(self.first_axis_angle), time)
        transl = spline_points(self.first_transl, time)
        return Instants(quats, transl, quats[0], transl[0])

    def counts(self, frames: int) -> Int64[Tensor, " F"]:
        """How many instants fitting takes of each exposure."""
        return self.taken.clone()

    def estimated_shutter(self, timestamps: Float[Tensor, " F"]) -> float | None:
        """How long the shutter was open, seconds, where that was an unknown of the motion."""
        if not self.log_shutter.requires_grad:
            return None
        spacing = (timestamps[-1] - timestamps[0]) / (self.middles[-1] - self.middles[0])
        return float(self.shutter.detach() * spacing)

    def mark_halfway(self) -> None:
        """Remember an estimated shutter as it is now, to tell later how far it has moved since."""
        if self.halfway is not None:
            self.halfway.copy_(self.log_shutter.detach())

    def take(self, counts: Int64[Tensor, " F"]) -> None:
        """Choose how many instants fitting takes of each exposure from now on."""
        self.taken.copy_(counts)

    def priors(self) -> dict[str, Float[Tensor, ""]]:
        """Penalties for leaving the first estimate, and for another shutter than guessed.

        `anchor` is the mean squared distance of the knots from the first ones, in radians of a
        joint's turn; `shutter` is the squared logarithm of its ratio to the guess.
        """
        quats = axis_angle_to_quat(self.axis_angle)
        first = axis_angle_to_quat(self.first_axis_angle)
        return {
            "anchor": _size(quat_to_axis_angle(quat_multiply(quat_conjugate(first), quats)))
            + _size((self.transl - self.first_transl) / LEVER),
            "shutter": self.log_shutter.square(),
        }


def _size(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, ""]:
    """Mean squared length; 0 of none."""
    return vectors.square().sum(-1).sum() / max(vectors[..., 0].numel(), 1)


def continuous(quats: Float[Tensor, "F J 4"]) -> Float[Tensor, "F J 4"]:
    """Choose, of the two quaternions of each rotation, the one nearer to the frame before."""
    flips = torch.where((quats[1:] * quats[:-1]).sum(-1) < 0, -1.0, 1.0)
    signs = torch.cat([torch.ones_like(flips[:1]), flips]).cumprod(0)
    return quats * signs[..., None]
