"""Trajectory of the authors' released code: a pair whose sharp render stays at the given pose."""

from dataclasses import replace
from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import axis_angle_to_quat
from deblur_avatar.motion.pair import PairMotion
from deblur_avatar.motion.per_frame import PerFrameParams
from deblur_avatar.motion.trajectory import Instants, MotionParams


class ReleasedParams(PerFrameParams):
    """A start and an end pose a frame; all noise is the start's."""

    kind: Literal["released"]


class ReleasedMotion(PairMotion):
    """A start and an end pose a frame; the noise is the start's alone, the middle the given pose.

    What is rendered sharp, and scored, is the pose that was given, which never moves.

    Source: facts of the code (xianrui-luo/deblur_avatar), `PoseInterpolation` and `render_pose`.
    """

    kind = "released"
    Params: ClassVar[type[MotionParams]] = ReleasedParams
    given: Tensor
    given_transl: Tensor

    def __init__(
        self, poses: Poses, u: Tensor, start_noise: float, generator: torch.Generator
    ) -> None:
        super().__init__(poses, u, 0.0, generator)
        self.register_buffer("given", poses.axis_angle)
        self.register_buffer("given_transl", poses.transl.clone())
        noise = torch.randn(self.start.shape, generator=generator)
        noise[:, 0] = 0
        with torch.no_grad():
            self.start.add_(start_noise * noise)

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """Virtual poses between start and end, and the given pose as the middle."""
        moving = super().at(frame, u)
        still = axis_angle_to_quat(self.given[frame])
        return replace(moving, centre_quats=still, centre_transl=self.given_transl[frame])
