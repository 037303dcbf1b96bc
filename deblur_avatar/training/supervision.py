"""Which renders of an exposure are compared with its frame, and which coverage with its matte.

Two tables by the names in `params.yaml`: `SUPERVISIONS` and `MASKS`. The authors' released code
compares several renders at once and changes its mind on the way.

Conventions. C is the sharp render at the middle, B the mean over the virtual instants, F their
blend by the fusion network. Iterations are the paper's 15,000.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.avatars.avatar import Rendering
from deblur_avatar.geometry.rotations import (
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.imaging.exposure import mean_of_instants, with_instant
from deblur_avatar.motion.trajectory import Trajectory

MaskName = Literal["mean", "union", "centre"]  # of `MASKS`
# From the render that the network looks at to the averaged one's share in each pixel.
Blend = Callable[[Float[Tensor, "H W 3"]], Float[Tensor, "H W 1"]]

# Of the released code's schedule; not parameters: it is reproduced as it is.
STILL_SHARE: Final = 0.1  # of the frames count as still, those that turn least
MOVING_WEIGHT: Final = 0.1  # of C in frames that move
BOTH_UNTIL: Final = 5000  # B is compared too


class Compared(NamedTuple):
    """A render that is compared with the frame, and its share of what is compared."""

    share: float
    image: Float[Tensor, "H W 3"]
    alpha: Float[Tensor, "H W"]


@dataclass(frozen=True)
class Exposure:
    """The renders of one exposure.

    instants: all of them, or their mean; the middle alone where nothing else is compared.
    sharp: at the middle, where it was rendered apart.
    """

    instants: Rendering
    sharp: Rendering | None

    @property
    def middle(self) -> Rendering:
        """At the middle of the exposure."""
        return self.instants if self.sharp is None else self.sharp

    @property
    def mean(self) -> Float[Tensor, "H W 3"]:
        """B."""
        return mean_of_instants(self.instants.image)

    @property
    def alpha(self) -> Float[Tensor, "H W"]:
        """Mean coverage."""
        return mean_of_instants(self.instants.alpha)

    def blended(
        self,
        image: Float[Tensor, "H W 3"],
        alpha: Float[Tensor, "H W"],
        share: Float[Tensor, "H W 1"],
    ) -> Compared:
        """F: C where `share` is 0, the instants' mean image and coverage where it is 1."""
        sharp, covered = self.middle.image[0], self.middle.alpha[0]
        alpha = torch.lerp(covered, alpha, share[..., 0])
        return Compared(1.0, torch.lerp(sharp, image, share), alpha)


@dataclass(frozen=True)
class Supervision:
    """One render is compared from beginning to end: C, B or F."""

    render: Literal["sharp", "mean", "fused"]

    @property
    def averages(self) -> bool:
        """Whether instants other than the middle are rendered."""
        return self.render != "sharp"

    @property
    def needs_sharp(self) -> bool:
        """Whether the middle is rendered apart from the instants."""
        return self.render == "fused"

    def compared(
        self, exposure: Exposure, blend: Blend | None, iteration: float, still: Callable[[], bool]
    ) -> list[Compared]:
        """The renders that are compared with the frame.

        Args:
            exposure: what was rendered.
            blend: the fusion network, where there is one.
            iteration: of the paper's 15,000.
            still: tells whether the frame counts as still.
        """
        if self.render == "fused":
            assert blend is not None
            share = blend(exposure.middle.image[0])
            return [exposure.blended(exposure.mean, exposure.alpha, share)]
        return [Compared(1.0, exposure.mean, exposure.alpha)]

    def alpha(self, exposure: Exposure) -> Float[Tensor, "H W"]:
        """Mean coverage of the instants that count."""
        return exposure.alpha

    def alphas(self, exposure: Exposure) -> Float[Tensor, "instants H W"]:
        """Coverage of each of them."""
        return exposure.instants.alpha


@dataclass(frozen=True)
class ReleasedSupervision(Supervision):
    """The released code's schedule of losses.

    After 5,000 iterations its B is compared no more, and after 7,000, where there is a fusion
    network, it is part of F without gradient. The sharp render is one more instant of the exposure,
    and of its coverage.

    Source: facts of the code (xianrui-luo/deblur_avatar, train.py).
    """

    render: Literal["fused"] = "fused"

    def compared(
        self, exposure: Exposure, blend: Blend | None, iteration: float, still: Callable[[], bool]
    ) -> list[Compared]:
        """C and B, then C (a tenth of it in frames that move) and F."""
        sharp, alpha = exposure.middle.image[0], exposure.middle.alpha[0]
        mean = with_instant(exposure.mean, exposure.instants.instants, sharp)
        covered = self.alpha(exposure)
        if iteration < BOTH_UNTIL:
            return [Compared(1.0, sharp, alpha), Compared(1.0, mean, covered)]
        compared = [Compared(1.0 if still() else MOVING_WEIGHT, sharp, alpha)]
        if blend is not None:
            mean = mean.detach()
            compared.append(exposure.blended(mean, covered.detach(), blend(mean)))
        return compared

    def alpha(self, exposure: Exposure) -> Float[Tensor, "H W"]:
        """Of the instants and the sharp render."""
        return with_instant(exposure.alpha, exposure.instants.instants, exposure.middle.alpha[0])

    def alphas(self, exposure: Exposure) -> Float[Tensor, "instants H W"]:
        """The instants', and the sharp render's."""
        return torch.cat([exposure.instants.alpha, exposure.middle.alpha])


SUPERVISIONS: dict[str, Supervision] = {
    "sharp": Supervision("sharp"),
    "mean": Supervision("mean"),
    "fused": Supervision("fused"),
    "released": ReleasedSupervision(),
}


@dataclass(frozen=True)
class Mask:
    """Which coverage is compared with the matte.

    of: the coverage, of what a supervision has rendered.
    each: whether every instant's own is needed, not only their mean.
    needs_sharp: whether the middle is rendered apart from the instants.
    """

    of: Callable[[Exposure, Supervision], Float[Tensor, "H W"]]
    each: bool = False
    needs_sharp: bool = False


def mean_coverage(exposure: Exposure, supervision: Supervision) -> Float[Tensor, "H W"]:
    """How much of the exposure a pixel was covered for."""
    return supervision.alpha(exposure)


def union_coverage(exposure: Exposure, supervision: Supervision) -> Float[Tensor, "H W"]:
    """Whether a pixel was covered at any instant."""
    return 1 - (1 - supervision.alphas(exposure)).prod(0)


def centre_coverage(exposure: Exposure, supervision: Supervision) -> Float[Tensor, "H W"]:
    """Coverage at the middle."""
    return mean_of_instants(exposure.middle.alpha)


MASKS: dict[str, Mask] = {
    "mean": Mask(mean_coverage),
    "union": Mask(union_coverage, each=True),
    "centre": Mask(centre_coverage, needs_sharp=True),
}


def still_frames(trajectory: Trajectory, frames: list[int]) -> set[int]:
    """The tenth of the frames whose joints turn least between the ends of the exposure."""
    turns = {}
    for frame in frames:
        quats = trajectory(frame).quats.detach()
        between = quat_to_axis_angle(quat_multiply(quat_conjugate(quats[0]), quats[-1]))
        turns[frame] = float(between.norm(dim=-1).max())
    order = sorted(frames, key=lambda frame: turns[frame])
    return set(order[: max(round(STILL_SHARE * len(frames)), 1)])
