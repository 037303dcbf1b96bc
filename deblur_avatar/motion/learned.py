"""Learned trajectory of each exposure: a network bends the straight pair (an ablation)."""

from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import axis_angle_to_quat, quat_multiply
from deblur_avatar.motion.pair import PairMotion
from deblur_avatar.motion.per_frame import PerFrameParams
from deblur_avatar.motion.trajectory import Instants, MotionParams

# Not parameters: the size is that of the authors' leftover network, the scale only a unit.
UNITS = 256
SCALE = 0.1  # radians and metres for an output of 1


class LearnedParams(PerFrameParams):
    """A start and an end pose a frame, and one network for all frames."""

    kind: Literal["learned"]


class LearnedMotion(PairMotion):
    """A start and an end pose a frame, joined as one network for all frames has learned to.

    The paper names such an ablation and says no more. Here the network sees both poses and u, and
    turns and shifts the pair's pose by an amount that vanishes at either end; nothing at first.
    """

    kind = "learned"
    Params: ClassVar[type[MotionParams]] = LearnedParams

    def __init__(
        self, poses: Poses, u: Tensor, start_noise: float, generator: torch.Generator
    ) -> None:
        super().__init__(poses, u, start_noise, generator)
        joints = self.start.shape[1]
        self.bend = nn.Sequential(
            nn.Linear(2 * 3 * joints + 1, UNITS), nn.LeakyReLU(),
            nn.Linear(UNITS, UNITS), nn.LeakyReLU(),
        )  # fmt: skip
        self.amount = nn.Linear(UNITS, 3 * joints + 3)
        nn.init.zeros_(self.amount.weight)
        nn.init.zeros_(self.amount.bias)

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """The pair's poses, bent."""
        straight = super().at(frame, u)
        times = torch.cat([u, u.new_tensor([0.5])])[:, None]
        ends = torch.cat([self.start[frame].flatten(), self.end[frame].flatten()])
        seen = torch.cat([ends.expand(len(times), -1), times], dim=1)
        change = SCALE * 4 * times * (1 - times) * self.amount(self.bend(seen))
        turns = axis_angle_to_quat(change[:, :-3].unflatten(1, (-1, 3)))
        quats = torch.cat([straight.quats, straight.centre_quats[None]])
        transl = torch.cat([straight.transl, straight.centre_transl[None]]) + change[:, -3:]
        bent = quat_multiply(quats, turns)
        return Instants(bent[:-1], transl[:-1], bent[-1], transl[-1])

    def parameter_groups(self) -> dict[str, list[tuple[str, Tensor]]]:
        """Those of a pair; the network learns at the rate of rotations."""
        groups = super().parameter_groups()
        for part in ("bend", "amount"):
            named = getattr(self, part).named_parameters()
            groups["poses"] += [(f"{part}.{name}", value) for name, value in named]
        return groups
