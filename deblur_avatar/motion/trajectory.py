"""Trajectories: where every joint is at any instant of any exposure.

Conventions. `u` in [0, 1] is time within one exposure: 0 when the shutter opens. A trajectory
answers, for one frame, with the joints' unit quaternions relative to their parents and the
translation at each of S instants. F frames, J joints. Every frame of the clip has a row; only those
that are trained move. A kind is a module of this package and its name in `kinds.py`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from deblur_avatar.artifacts.motion import Motion, named_on_disk
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.config.section import Params, Positive
from deblur_avatar.geometry.rotations import quat_to_axis_angle, quat_to_matrix

# Metres that a joint's turn of one radian moves what hangs on it, roughly. Not a parameter: it is
# the unit in which penalties add shifts to turns, and their weights are parameters.
LEVER = 0.3

Quadrature = Literal["endpoints", "midpoints"]
# The average of one frame's renders at some instants, sRGB [H, W, 3].
Render = Callable[[int, "Instants"], Tensor]


# What is known of a motion beforehand: penalties by the names of their weights, each computed when
# it is called.
Priors = dict[str, Callable[[], Tensor]]


class MotionParams(Params):
    """Parameters of one kind of trajectory; each kind adds its own, beside its class."""

    kind: str

    def learning_rates(self) -> dict[str, float]:
        """The rate of each of its parameter groups; none of a motion that is no unknown."""
        return {}

    def weights(self) -> dict[str, float]:
        """Weights of its priors."""
        return {}


class MotionRates(Params):
    """Learning rates of a motion's unknowns."""

    poses: Positive  # radians a step
    transl: Positive  # metres a step


class FittedMotionParams(MotionParams):
    """Parameters of a trajectory that has unknowns."""

    rates: MotionRates

    def learning_rates(self) -> dict[str, float]:
        """Those of rotations and of translations."""
        return self.rates.model_dump()


@dataclass(frozen=True)
class Instants:
    """Joint rotations and translation at S instants of one exposure, and at its middle."""

    quats: Float[Tensor, "S J 4"]
    transl: Float[Tensor, "S 3"]
    centre_quats: Float[Tensor, "J 4"]
    centre_transl: Float[Tensor, " 3"]

    @property
    def rotations(self) -> Float[Tensor, "S J 3 3"]:
        """Rotation matrices of all instants."""
        return quat_to_matrix(self.quats)

    @property
    def centre_rotations(self) -> Float[Tensor, "J 3 3"]:
        """Rotation matrices at the middle."""
        return quat_to_matrix(self.centre_quats)

    def poses(self, betas: Float[Tensor, " B"]) -> Poses:
        """The poses at the instants, of a body of this shape."""
        return poses_of(betas, self.quats, self.transl)


class Trajectory(nn.Module, ABC):
    """The motion of the whole clip, with its unknowns.

    `kind` names it in `params.yaml` and on disk, `Params` is its section there. `knows_unfitted`
    says whether its rows of frames that were not fitted are as good as others: where each frame has
    unknowns of its own, those of such a frame are what they began as.
    """

    kind: ClassVar[str]
    Params: ClassVar[type[MotionParams]]
    knows_unfitted: ClassVar[bool]
    u: Tensor

    @classmethod
    @abstractmethod
    def create(
        cls, observations: Observations, params: Any, generator: torch.Generator
    ) -> "Trajectory":
        """The trajectory before fitting, near the given poses; `params` are of its `Params`.

        Raises:
            ConfigError: if the clip lacks what such a trajectory needs to know.
        """

    @classmethod
    @abstractmethod
    def from_artifact(cls, motion: Motion) -> "Trajectory":
        """Rebuild what `to_artifact` saved, so that a later stage can go on with it."""

    @abstractmethod
    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """The poses of one exposure at any instants."""

    @abstractmethod
    def parameter_groups(self) -> dict[str, list[tuple[str, Tensor]]]:
        """Parameters by the learning rate they take (`MotionParams.learning_rates`), with names.

        Those that are no unknowns do not require a gradient.
        """

    def forward(self, frame: int) -> Instants:
        """The poses of one exposure at the instants that fitting takes."""
        return self.at(frame, self.u)

    def priors(self, frame: int, instants: Instants, observations: Observations) -> Priors:
        """What is known of such motion beforehand, by names that its parameters' `weights` know.

        Args:
            frame: that is fitted in this step.
            instants: of it.
            observations: what the camera saw, and what is known of it.
        """
        return {}

    def num_samples(self, frames: int) -> Int64[Tensor, " F"]:
        """How many instants fitting takes of each exposure."""
        return torch.full((frames,), len(self.u))

    def limit_samples(self, max_samples: int) -> None:
        """Take no more instants of an exposure in fitting, where their number may vary.

        What is saved still says how many an exposure needs.
        """

    def choose_samples(self, observations: Observations) -> None:
        """Choose how many instants fitting takes of each exposure, if that depends on the motion.

        Called before and after the stage that fits the motion.
        """

    def keep_possible(self) -> None:
        """Bring unknowns back that have gone where they cannot be; called after a step."""

    def remember_halfway(self) -> None:
        """Take note of what is needed later; called in the middle of that stage."""

    def settle(self, observations: Observations, render: Render) -> dict[str, Any]:
        """Decide what fitting leaves open, at the end of that stage; returns what to report.

        Args:
            observations: what the camera saw.
            render: the fitted avatar's average at some instants of a frame.
        """
        return {}

    def estimated_shutter(self, timestamps: Float[Tensor, " F"]) -> float | None:
        """How long the shutter was open, seconds, where that was an unknown of the motion."""
        return None

    @torch.no_grad()
    def to_artifact(self, betas: Tensor, timestamps: Tensor) -> Motion:
        """Sample every exposure, and keep the unknowns so that a later stage can go on."""
        frames = [self.at(index, self.u) for index in range(len(timestamps))]
        quats = torch.stack([frame.quats for frame in frames]).cpu()
        transl = torch.stack([frame.transl for frame in frames]).cpu()
        axis_angle = quat_to_axis_angle(quats)
        return Motion(
            kind=self.kind,
            u=self.u.cpu(),
            timestamps=timestamps,
            num_samples=self.num_samples(len(timestamps)).cpu(),
            shutter=self.estimated_shutter(timestamps),
            global_orient=axis_angle[:, :, 0],
            body_pose=axis_angle[:, :, 1:],
            transl=transl,
            centre=poses_of(
                betas.cpu(),
                torch.stack([frame.centre_quats for frame in frames]).cpu(),
                torch.stack([frame.centre_transl for frame in frames]).cpu(),
            ),
            # Clones: fitting works in place, and an artifact never changes.
            parameters=named_on_disk(
                {name: value.cpu().clone() for name, value in self.state_dict().items()}
            ),
        )


def poses_of(
    betas: Float[Tensor, " B"], quats: Float[Tensor, "F J 4"], transl: Float[Tensor, "F 3"]
) -> Poses:
    """Poses of F instants from the joints' rotations, the root's first."""
    axis_angle = quat_to_axis_angle(quats)
    return Poses(
        betas=betas, global_orient=axis_angle[:, 0], body_pose=axis_angle[:, 1:], transl=transl
    )


def instants(count: int, quadrature: str) -> Float[Tensor, " S"]:
    """Quadrature nodes: where in the exposure `count` virtual poses stand.

    `endpoints` includes both ends, as the paper does; `midpoints` are the middles of equal parts,
    which do not shorten the motion that explains a blur by (count - 1) / count.
    """
    if count == 1:
        return torch.tensor([0.5])
    if quadrature == "endpoints":
        return torch.linspace(0, 1, count)
    return (torch.arange(count) + 0.5) / count
