"""Cubic B-spline trajectory of the whole clip, of which every exposure is a piece.

Conventions. Knots stand evenly in time; `middles` are the frames' middles in units of the knots'
spacing. F frames, K knots, J joints, S instants. Penalties weigh a shift against a joint's turn by
LEVER.
"""

import logging
import math
from typing import Annotated, Any, ClassVar, Literal

import torch
from jaxtyping import Float, Int64
from pydantic import Field
from torch import Tensor, nn

from deblur_avatar.artifacts.motion import Motion, named_in_code
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import joints_from_rotations
from deblur_avatar.config.section import Count, NonNegative, Params, Positive
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    continuous,
    quat_to_axis_angle,
)
from deblur_avatar.geometry.splines import fit_knots
from deblur_avatar.imaging.exposure import GUESS_STD
from deblur_avatar.motion.knot_spacing import choose_spacing
from deblur_avatar.motion.pose_spline import knot_distance, pose_spline
from deblur_avatar.motion.shutter_certainty import MAX_LOG_RATIO, shutter_std
from deblur_avatar.motion.trajectory import (
    LEVER,
    FittedMotionParams,
    Instants,
    MotionParams,
    Priors,
    Quadrature,
    Render,
    Trajectory,
    instants,
)
from deblur_avatar.motion.virtual_poses import farthest_travel

logger = logging.getLogger(__name__)

# Not a parameter: the unit of `pixels_per_pose`. How many instants explain a blur depends on how
# far it goes in terms of the person, so that pictures of a clip at any size take as many.
REFERENCE_HEIGHT = 192  # pixels
ROUNDED = 1e-5  # share by which times of four bytes may be off


class GivenShutter(Params):
    """The clip says how long the shutter was open."""

    kind: Literal["given"]


class EstimatedShutter(Params):
    """How long the shutter was open is an unknown, near what the clip says.

    Always, or as told: where the clip says that it guesses.
    """

    kind: Literal["estimated", "as_told"]
    rate: Positive  # learning rate: share of itself a step
    weight: NonNegative  # of the squared logarithm of its ratio to what the clip says


class ClipPriors(Params):
    """Weights of what holds the trajectory near the given poses."""

    anchor: NonNegative  # knots stay near the first estimate
    depth: NonNegative  # so do joints' distances from the camera, where depth is known


class ClipParams(FittedMotionParams):
    """One trajectory for the whole clip."""

    kind: Literal["clip"]
    virtual_poses: Count  # at most, where `pixels_per_pose` says how many
    # Farthest travel per virtual pose, in pixels of a picture 192 high; 0: always all of them.
    pixels_per_pose: NonNegative
    shutter: Annotated[GivenShutter | EstimatedShutter, Field(discriminator="kind")]
    quadrature: Quadrature  # of the instants that are saved; fitting takes midpoints
    knot_frames: Positive  # frames between two knots of the trajectory, at most
    finest_knot_frames: Positive  # and at least, where given poses ask for finer knots
    finer_knots_gain: NonNegative  # radians by which these must predict held-back poses better
    smoothness: NonNegative  # of the first trajectory, against closeness to the given poses
    priors: ClipPriors

    def learning_rates(self) -> dict[str, float]:
        """Those of the knots, and of a shutter that may be an unknown."""
        rates = super().learning_rates()
        shutter = self.shutter
        return rates | ({} if shutter.kind == "given" else {"shutter": shutter.rate})

    def weights(self) -> dict[str, float]:
        """Weights of its priors."""
        weights = self.priors.model_dump()
        shutter = self.shutter
        return weights | ({} if shutter.kind == "given" else {"shutter": shutter.weight})

    def estimates_shutter(self, observations: Observations) -> bool:
        """Whether how long the shutter was open is an unknown."""
        told = self.shutter.kind == "as_told" and observations.exposure_std is not None
        return told or self.shutter.kind == "estimated"


class ClipMotion(Trajectory):
    """A cubic B-spline of every joint's rotation and of the translation.

    Neighbouring frames say which way a limb moves, exposures may overlap or leave gaps, and frames
    that were never fitted lie on the curve too.

    Source: design of this project, after continuous-time trajectories (BAD-Gaussians; Casual3DHDR).
    """

    kind = "clip"
    Params: ClassVar[type[MotionParams]] = ClipParams
    knows_unfitted = True
    middles: Tensor
    guess: Tensor
    samples_per_frame: Tensor
    halfway: Tensor | None
    initial_axis_angle: Tensor
    initial_transl: Tensor

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
        self._pixels_per_pose = 0.0
        self._max_samples = len(u)
        self._initial_depths: dict[int, Tensor] = {}  # by frame
        self._estimated_shutter = estimate_shutter
        self._max_log_shutter = math.inf  # what `log_shutter` can be
        self.register_buffer("u", u, persistent=False)
        self.register_buffer("middles", middles)
        self.register_buffer("guess", guess)
        self.register_buffer("samples_per_frame", torch.full(middles.shape, len(u)))
        self.register_buffer("initial_axis_angle", axis_angle.clone())
        self.register_buffer("initial_transl", transl.clone())
        self.axis_angle = nn.Parameter(axis_angle)
        self.transl = nn.Parameter(transl)
        self.log_shutter = nn.Parameter(guess.new_zeros(()), requires_grad=estimate_shutter)
        self.register_buffer("halfway", guess.new_zeros(()) if estimate_shutter else None)

    @classmethod
    def create(
        cls, observations: Observations, params: ClipParams, generator: torch.Generator
    ) -> "ClipMotion":
        """The smoothest curve near the given poses, with knots as close as these ask for.

        Raises:
            ConfigError: if the exposure is unknown, or there is a single frame.
        """
        if observations.exposure is None:
            raise ConfigError(
                "kind: clip needs to know how long the shutter was open; the clip does not say"
            )
        if len(observations.timestamps) < 2:
            raise ConfigError(
                "kind: clip needs two frames or more, the clip has 1: a single blurred frame "
                "does not tell which way it moved; take more frames, or a method with kind: pair"
            )
        frame = float(observations.timestamps.diff().median())
        spacing = choose_spacing(
            observations.poses, observations.timestamps, observations.weights > 0,
            params.knot_frames * frame, params.finest_knot_frames * frame,
            params.smoothness, params.finer_knots_gain,
        )  # fmt: skip
        motion = cls.near(
            observations.poses, instants(params.virtual_poses, params.quadrature),
            observations.timestamps, observations.exposure, spacing, params.smoothness,
            estimate_shutter=params.estimates_shutter(observations),
        )  # fmt: skip
        motion._pixels_per_pose = params.pixels_per_pose
        if observations.exposure_std is not None and observations.exposure < frame * (1 + ROUNDED):
            motion._max_log_shutter = max(math.log(frame / observations.exposure), 0.0)
        return motion

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
        reach = exposure / 2 * (math.exp(MAX_LOG_RATIO) if estimate_shutter else 1)
        first = float(timestamps[0]) - reach
        span = float(timestamps[-1]) + reach - first
        count = max(round(span / knot_spacing) + 1, 2)
        spacing = span / (count - 1)
        middles = (timestamps - first) / spacing
        quats = continuous(axis_angle_to_quat(poses.axis_angle))
        knots = fit_knots(quats.flatten(1), middles, count, smoothness).unflatten(1, (-1, 4))
        axis_angle = quat_to_axis_angle(nn.functional.normalize(knots, dim=-1))
        transl = fit_knots(poses.transl, middles, count, smoothness)
        guess = torch.tensor(exposure / spacing)
        return cls(u, middles, guess, axis_angle, transl, estimate_shutter=estimate_shutter)

    @classmethod
    def from_artifact(cls, motion: Motion) -> "ClipMotion":
        """The trajectory that `to_artifact` saved; its shutter is settled."""
        saved = named_in_code(motion.parameters)
        names = ("middles", "guess", "axis_angle", "transl")
        # Clones: fitting works in place, and an artifact never changes.
        tensors = (saved[name].clone() for name in names)
        trajectory = cls(motion.u, *tensors, estimate_shutter=False)
        trajectory.load_state_dict({name: saved[name] for name in trajectory.state_dict()})
        trajectory._estimated_shutter = motion.shutter is not None
        return trajectory

    @property
    def shutter(self) -> Float[Tensor, ""]:
        """How long the shutter was open, in units of the knots' spacing."""
        return self.guess * self.log_shutter.clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO).exp()

    def forward(self, frame: int) -> Instants:
        """The piece of the trajectory that one exposure sees, at as many instants as it needs."""
        count = min(int(self.samples_per_frame[frame]), self._max_samples)
        return self.at(frame, instants(count, "midpoints").to(self.u))

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """The piece of the trajectory that one exposure sees."""
        times = self.middles[frame] + (torch.cat([u, u.new_tensor([0.5])]) - 0.5) * self.shutter
        quats, transl = pose_spline(self.axis_angle, self.transl, times)
        return Instants(quats[:-1], transl[:-1], quats[-1], transl[-1])

    def initial(self, frame: int) -> Instants:
        """The middle of one exposure as it was before fitting."""
        time = self.middles[frame : frame + 1]
        quats, transl = pose_spline(self.initial_axis_angle, self.initial_transl, time)
        return Instants(quats, transl, quats[0], transl[0])

    def num_samples(self, frames: int) -> Int64[Tensor, " F"]:
        """How many instants fitting takes of each exposure."""
        return self.samples_per_frame.clone()

    def limit_samples(self, max_samples: int) -> None:
        """Few instants are enough for a coarse picture."""
        self._max_samples = max_samples

    def choose_samples(self, observations: Observations) -> None:
        """A virtual pose per `pixels_per_pose` of the farthest travel."""
        if self._pixels_per_pose > 0:
            height = observations.frames.shape[1]
            travel = farthest_travel(self, observations) * (REFERENCE_HEIGHT / height)
            wanted = (travel / self._pixels_per_pose).ceil().long()
            self.samples_per_frame.copy_(wanted.clamp(1, len(self.u)))

    def estimated_shutter(self, timestamps: Float[Tensor, " F"]) -> float | None:
        """How long the shutter was open, seconds, where that was an unknown of the motion."""
        if not self._estimated_shutter:
            return None
        spacing = (timestamps[-1] - timestamps[0]) / (self.middles[-1] - self.middles[0])
        return float(self.shutter.detach() * spacing)

    @torch.no_grad()
    def keep_possible(self) -> None:
        """A camera's shutter is closed when the next frame begins, where that is only guessed."""
        self.log_shutter.clamp_(max=self._max_log_shutter)

    def remember_halfway(self) -> None:
        """Remember an estimated shutter as it is now, to tell later how far it has moved since."""
        if self.halfway is not None:
            self.halfway.copy_(self.log_shutter.detach())

    def settle(self, observations: Observations, render: Render) -> dict[str, Any]:
        """Keep an estimated shutter, or go back to the guess where the frames do not tell it.

        Its variance is the frames' (`shutter_std`) plus the square of how far it moved in the last
        half of the stage, which stands for how far it still is from where it would converge.
        Frames and guess are weighed as independent.

        Returns:
            `shutter_s` and `shutter_std_s`, seconds, and who told it: `shutter_from` frames or
            guess. Nothing of a shutter that was given.
        """
        if self.halfway is None:
            return {}

        def exposed(frame: int, log_shutter: float) -> Tensor:
            return render(frame, self.with_shutter(frame, log_shutter))

        guess = observations.exposure_std or GUESS_STD
        told = shutter_std(exposed, self.log_shutter, observations)
        source = "frames" if told < guess else "guess"
        moved = float(self.log_shutter.detach() - self.halfway)
        if source == "guess":
            with torch.no_grad():
                self.log_shutter.zero_()
            std = guess
            told_as = "nothing moved enough to tell: the guess stands"
        else:
            std = (1 / (told**2 + moved**2) + 1 / guess**2) ** -0.5
            told_as = f"it moved by {math.expm1(moved):+.1%} in the last half of the stage"
            if float(self.log_shutter.detach()) > self._max_log_shutter - ROUNDED:
                told_as = "as long as frames are apart, and it cannot be longer"
        shutter = self.estimated_shutter(observations.timestamps)
        assert shutter is not None
        logger.info(
            "the shutter was open for %.1f ms, give or take %.1f; %s",
            1e3 * shutter, 1e3 * shutter * std, told_as,
        )  # fmt: skip
        return {"shutter_s": shutter, "shutter_std_s": shutter * std, "shutter_from": source}

    @torch.no_grad()
    def with_shutter(self, frame: int, log_shutter: float) -> Instants:
        """The instants of one exposure, had the logarithm of the shutter been this."""
        fitted = self.log_shutter.detach().clone()
        self.log_shutter.fill_(log_shutter)
        exposure = self(frame)
        self.log_shutter.copy_(fitted)
        return exposure

    def parameter_groups(self) -> dict[str, list[tuple[str, Tensor]]]:
        """Rotations and translations of the knots, and the shutter."""
        return {
            "poses": [("axis_angle", self.axis_angle)],
            "transl": [("transl", self.transl)],
            "shutter": [("log_shutter", self.log_shutter)],
        }

    def priors(self, frame: int, instants: Instants, observations: Observations) -> Priors:
        """Penalties for leaving the first estimate, and for another shutter than guessed.

        `anchor` is the mean squared distance of the knots from the first ones, in units of how far
        the given poses may be off (`pose_std`); `depth` is that of the joints' depths at the middle
        of this exposure, where other cameras have told them; `shutter` is the squared logarithm of
        its ratio to the guess.
        """
        priors: Priors = {"anchor": lambda: self._anchor() / observations.pose_std**2}
        if self.log_shutter.requires_grad:
            priors["shutter"] = self.log_shutter.square
        if observations.depth_known:
            priors["depth"] = lambda: self._depth(frame, instants, observations)
        return priors

    def _anchor(self) -> Float[Tensor, ""]:
        first = self.initial_axis_angle, self.initial_transl
        return knot_distance(self.axis_angle, self.transl, first, LEVER)

    def _depth(
        self, frame: int, instants: Instants, observations: Observations
    ) -> Float[Tensor, ""]:
        if frame not in self._initial_depths:
            with torch.no_grad():
                self._initial_depths[frame] = _depths(self.initial(frame), observations)
        # Steps towards the camera, in radians of a joint's turn.
        shift = (_depths(instants, observations) - self._initial_depths[frame]) / LEVER
        return shift.square().mean()


def _depths(instants: Instants, observations: Observations) -> Float[Tensor, " J"]:
    """How far the joints are from the camera at the middle of an exposure, metres."""
    transl = instants.centre_transl
    places = joints_from_rotations(
        observations.body, observations.poses.betas.to(transl), instants.centre_rotations, transl
    )
    viewmat = observations.camera.viewmat.to(transl)
    return places @ viewmat[2, :3] + viewmat[2, 3]
