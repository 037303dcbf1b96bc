"""MAD-Avatar's trajectory of each exposure: a cubic B-spline of turns, and a shared pose network.

Conventions. Those of `trajectory`. Knots are turns of joints away from their given rotations,
axis-angle, and translations. `overlap` is the exposure as a multiple of the time between the
middles of two frames: above 1 exposures overlap, below 1 they leave a gap.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import ClassVar, Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from deblur_avatar.artifacts.motion import Motion, named_in_code
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.config.section import NonNegative, Params
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.geometry.splines import basis
from deblur_avatar.motion.per_frame import PerFrameParams, PerFrameTrajectory
from deblur_avatar.motion.pose_network import PoseNetwork, PoseNetworkParams, named_weights
from deblur_avatar.motion.trajectory import Instants, MotionParams, Priors, instants

KNOTS = 4  # not a parameter: what one segment of a cubic B-spline has


class MadPriors(Params):
    """Weights of what holds the trajectory together."""

    continuity: NonNegative  # neighbouring exposures agree where they meet


class MadParams(PerFrameParams):
    """Four knots a frame, and what neighbouring frames have to do with each other."""

    kind: Literal["mad"]
    pose_network: PoseNetworkParams | None  # corrects every instant's pose; null: nothing does
    # Where neighbouring exposures must agree. literal: the end of one with the start of the next,
    # as published; overlap: at the times that both of them see.
    continuity: Literal["literal", "overlap"]
    priors: MadPriors

    def learning_rates(self) -> dict[str, float]:
        """Those of the knots, and of the network."""
        rates, network = super().learning_rates(), self.pose_network
        return rates if network is None else rates | {"pose_network": network.rate}

    def weights(self) -> dict[str, float]:
        """Weights of its priors."""
        return self.priors.model_dump()


class MadMotion(PerFrameTrajectory):
    """Four knots a frame, a network for all frames, and a prior that joins neighbouring frames.

    Frames share no knots: that a body moves on from one exposure into the next is asked for by the
    prior alone. The curve is of turns away from the given rotations, so that no joint comes near
    half a turn; the network corrects its pose at every instant. What else differs from the
    published method is in docs/decisions/0037-mad.md.

    Source: MAD-Avatar (arXiv 2411.16758, CVPR 2026), by facts of its code and text.
    """

    kind = "mad"
    Params: ClassVar[type[MotionParams]] = MadParams
    given: Tensor
    compares_overlap: Bool[Tensor, ""]

    def __init__(
        self, poses: Poses, u: Tensor, start_noise: float, generator: torch.Generator
    ) -> None:
        super().__init__(poses, u, start_noise, generator)
        given = poses.axis_angle
        noise = torch.randn(given.shape, generator=generator) * start_noise
        noise[:, 0] = 0  # as of a pair
        # On a line, so that the curve starts half the noise ahead and ends half of it behind.
        along = torch.tensor([1.5, 0.5, -0.5, -1.5]).to(given)[:, None, None]
        self.register_buffer("given", given)
        # Saved, so that the last stage, which rebuilds the motion, asks for the same.
        self.register_buffer("compares_overlap", torch.tensor(True))
        self.offsets = nn.Parameter(along * noise[:, None])
        self.transl = nn.Parameter(poses.transl[:, None].repeat(1, KNOTS, 1))
        self.pose_network: PoseNetwork | None = None

    @classmethod
    def create(
        cls, observations: Observations, params: PerFrameParams, generator: torch.Generator
    ) -> "MadMotion":
        """The given poses, parted by noise.

        Raises:
            ConfigError: if overlaps are asked for and the exposure is unknown.
        """
        assert isinstance(params, MadParams)
        if params.continuity == "overlap" and observations.exposure is None:
            raise ConfigError(
                "kind: mad with continuity: overlap needs to know how long the shutter was open; "
                "the clip does not say. Give the clip's exposure, or take continuity: literal"
            )
        u = instants(params.virtual_poses, params.quadrature)
        motion = cls(observations.poses, u, params.start_noise, generator)
        motion.compares_overlap.fill_(params.continuity == "overlap")
        if params.pose_network is not None:
            joints = motion.given.shape[1]
            motion.pose_network = PoseNetwork(joints, params.pose_network.hidden, generator)
        return motion

    @classmethod
    def from_artifact(cls, motion: Motion) -> "MadMotion":
        """Rebuild what was saved."""
        saved = named_in_code(motion.parameters)
        trajectory = cls(motion.centre, motion.u, 0.0, torch.Generator())
        trajectory.pose_network = PoseNetwork.saved_in(saved, "pose_network")
        # Copies values: fitting works in place, and an artifact never changes.
        trajectory.load_state_dict(saved)
        return trajectory

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """The curve of one exposure."""
        u = torch.cat([u, u.new_tensor([0.5])])  # the last one is the middle
        quats, transl = self._poses([frame] * len(u), u)
        return Instants(quats[:-1], transl[:-1], quats[-1], transl[-1])

    def priors(self, frame: int, instants: Instants, observations: Observations) -> Priors:
        """A penalty for not going on as the neighbouring frames do.

        `continuity` is how far apart two exposures say that the body is at one time: the mean angle
        of the joints, radians, plus that of the translation's coordinates, metres; the mean over
        the fitted frames next to this one, before and after. A frame by itself has none.
        """
        pairs = _neighbours(frame, observations)
        return {"continuity": lambda: self._apart(pairs, observations)} if pairs else {}

    def parameter_groups(self) -> dict[str, list[tuple[str, Tensor]]]:
        """Rotations and translations of the knots, and the network."""
        return {
            "poses": [("offsets", self.offsets)],
            "transl": [("transl", self.transl)],
            "pose_network": named_weights(self.pose_network),
        }

    def _poses(
        self, frames: Sequence[int], u: Float[Tensor, " S"]
    ) -> tuple[Float[Tensor, "S J 4"], Float[Tensor, "S 3"]]:
        """Rotations and translations at an instant of each of some exposures, in one call."""
        rows = torch.tensor(frames, device=u.device)
        knots, weights = basis(1 + u, KNOTS)  # the curve is the segment between the inner knots
        offsets = weights[:, :, None, None] * self.offsets[rows[:, None], knots]
        transl = weights[:, :, None] * self.transl[rows[:, None], knots]
        given = axis_angle_to_quat(self.given[rows])
        quats = quat_multiply(given, axis_angle_to_quat(offsets.sum(1)))
        if self.pose_network is not None:
            quats = self.pose_network(quats)
        return quats, transl.sum(1)

    def _apart(
        self, pairs: Sequence[tuple[int, int]], observations: Observations
    ) -> Float[Tensor, ""]:
        """How far apart the exposures of each pair say that the body is where they meet."""
        here: list[tuple[int, float]] = []  # a frame and u, of the earlier one of a pair
        there: list[tuple[int, float]] = []
        counts = []
        for earlier, later in pairs:
            seen = meeting(self._overlap(earlier, later, observations))
            here += [(earlier, u) for u in seen[0]]
            there += [(later, u) for u in seen[1]]
            counts.append(len(seen[0]))
        frames, times = zip(*here, *there, strict=True)
        quats, transl = self._poses(frames, self.given.new_tensor(times))
        earlier_quats, later_quats = quats.chunk(2)
        turns = quat_to_axis_angle(quat_multiply(quat_conjugate(earlier_quats), later_quats))
        earlier_transl, later_transl = transl.chunk(2)
        apart = turns.norm(dim=-1).mean(-1) + (later_transl - earlier_transl).abs().mean(-1)
        return torch.stack([part.mean() for part in apart.split(counts)]).mean()

    def _overlap(self, earlier: int, later: int, observations: Observations) -> float:
        """What `meeting` is to know of two exposures."""
        if observations.exposure is None or not self.compares_overlap:
            return 0.0
        step = observations.timestamps[later] - observations.timestamps[earlier]
        return observations.exposure / float(step)


def meeting(overlap: float) -> tuple[list[float], list[float]]:
    """Where two exposures, one after the other, are compared: u of the one and u of the other.

    Exposures that overlap are compared at the beginning, the middle and the end of the time that
    both see. Others are asked to meet: the end of the one with the start of the other.

    Args:
        overlap: the exposure as a multiple of the time between the two middles.
    """
    if overlap <= 1:
        return [1.0], [0.0]
    step = 1 / overlap  # what u of the second lags behind
    here = [step, (1 + step) / 2, 1.0]
    return here, [u - step for u in here]


def _neighbours(frame: int, observations: Observations) -> list[tuple[int, int]]:
    """The fitted frames next to one in time, each paired with it, the earlier first."""
    shows_person = (observations.weights > 0).tolist()
    fitted = sorted(index for index in observations.train if shows_person[index])
    before = [index for index in fitted if index < frame]
    after = [index for index in fitted if index > frame]
    return list(pairwise([*before[-1:], frame, *after[:1]]))
