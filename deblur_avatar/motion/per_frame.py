"""Trajectories of single exposures: every frame has unknowns of its own.

Conventions. Those of `trajectory`. The middle stays at the given pose at first.
"""

import torch
from torch import Tensor

from deblur_avatar.artifacts.motion import Motion, named_in_code
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.config.section import Count, NonNegative
from deblur_avatar.motion.trajectory import (
    FittedMotionParams,
    Quadrature,
    Trajectory,
    instants,
)


class PerFrameParams(FittedMotionParams):
    """What such trajectories have in common."""

    virtual_poses: Count
    quadrature: Quadrature
    start_noise: NonNegative  # radians by which the limbs' first start and end are apart


class PerFrameTrajectory(Trajectory):
    """Unknowns for every exposure, parted by noise before fitting; abstract."""

    knows_unfitted = False

    def __init__(
        self, poses: Poses, u: Tensor, start_noise: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.register_buffer("u", u, persistent=False)

    @classmethod
    def create(
        cls, observations: Observations, params: PerFrameParams, generator: torch.Generator
    ) -> "PerFrameTrajectory":
        """The given poses, parted by noise."""
        u = instants(params.virtual_poses, params.quadrature)
        return cls(observations.poses, u, params.start_noise, generator)

    @classmethod
    def from_artifact(cls, motion: Motion) -> "PerFrameTrajectory":
        """Rebuild what was saved."""
        trajectory = cls(motion.centre, motion.u, 0.0, torch.Generator())
        # Copies values: fitting works in place, and an artifact never changes.
        trajectory.load_state_dict(named_in_code(motion.parameters))
        return trajectory
