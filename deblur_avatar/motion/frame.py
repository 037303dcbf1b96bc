"""Static trajectory: one pose a frame, as without a model of blur."""

from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.motion import Motion, named_in_code
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import axis_angle_to_quat
from deblur_avatar.motion.trajectory import (
    FittedMotionParams,
    Instants,
    MotionParams,
    Trajectory,
)


class FrameParams(FittedMotionParams):
    """Every frame's pose is an unknown."""

    kind: Literal["frame"]


class FixedParams(MotionParams):
    """Poses stay as they were given."""

    kind: Literal["fixed"]


class FrameMotion(Trajectory):
    """Every frame's pose is an unknown (3DGS-Avatar's pose correction)."""

    kind = "frame"
    Params: ClassVar[type[MotionParams]] = FrameParams
    knows_unfitted = False
    refined: ClassVar[bool] = True

    def __init__(self, poses: Poses) -> None:
        super().__init__()
        self.register_buffer("u", torch.tensor([0.5]), persistent=False)
        self.axis_angle = nn.Parameter(poses.axis_angle, requires_grad=self.refined)
        self.transl = nn.Parameter(poses.transl.clone(), requires_grad=self.refined)

    @classmethod
    def create(
        cls, observations: Observations, params: MotionParams, generator: torch.Generator
    ) -> "FrameMotion":
        """The given poses."""
        return cls(observations.poses)

    @classmethod
    def from_artifact(cls, motion: Motion) -> "FrameMotion":
        """Rebuild what was saved."""
        trajectory = cls(motion.centre)
        # Copies values: fitting works in place, and an artifact never changes.
        trajectory.load_state_dict(named_in_code(motion.parameters))
        return trajectory

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """The frame's one pose, at every instant."""
        quats, transl = axis_angle_to_quat(self.axis_angle[frame]), self.transl[frame]
        return Instants(quats.expand(len(u), -1, -1), transl.expand(len(u), -1), quats, transl)

    def parameter_groups(self) -> dict[str, list[tuple[str, Tensor]]]:
        """Rotations and translations."""
        return {"poses": [("axis_angle", self.axis_angle)], "transl": [("transl", self.transl)]}


class FixedMotion(FrameMotion):
    """Poses stay as they were given, so that a frame that was not fitted is as well known."""

    kind = "fixed"
    Params = FixedParams
    knows_unfitted = True
    refined = False
