"""Linear trajectory of each exposure: a start and an end pose, joined along the shortest arcs."""

from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import axis_angle_to_quat, slerp
from deblur_avatar.motion.per_frame import PerFrameParams, PerFrameTrajectory
from deblur_avatar.motion.trajectory import Instants, MotionParams


class PairParams(PerFrameParams):
    """A start and an end pose a frame."""

    kind: Literal["pair"]


class PairMotion(PerFrameTrajectory):
    """A start and an end pose a frame.

    Source: Deblur-Avatar (arXiv 2501.13335) sec. III-B. Equal start and end poses are a saddle
    point with equal gradients, so they are parted by noise: half of it forward and half back, so
    that the middle stays the given pose (the authors' code disturbs the start alone).
    """

    kind = "pair"
    Params: ClassVar[type[MotionParams]] = PairParams

    def __init__(
        self, poses: Poses, u: Tensor, start_noise: float, generator: torch.Generator
    ) -> None:
        super().__init__(poses, u, start_noise, generator)
        given = poses.axis_angle
        noise = torch.randn(given.shape, generator=generator)
        noise = noise * start_noise / 2
        noise[:, 0] = 0  # the root parts by itself once the limbs have
        self.start = nn.Parameter(given + noise)
        self.end = nn.Parameter(given - noise)
        self.start_transl = nn.Parameter(poses.transl.clone())
        self.end_transl = nn.Parameter(poses.transl.clone())

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """Virtual poses between start (u = 0) and end (u = 1)."""
        u = torch.cat([u, u.new_tensor([0.5])])
        quats = slerp(axis_angle_to_quat(self.start[frame]), axis_angle_to_quat(self.end[frame]), u)
        start, end = self.start_transl[frame], self.end_transl[frame]
        transl = start + u[:, None] * (end - start)
        return Instants(quats[:-1], transl[:-1], quats[-1], transl[-1])

    def parameter_groups(self) -> dict[str, list[tuple[str, Tensor]]]:
        """Rotations and translations of both ends."""
        return {
            "poses": [("start", self.start), ("end", self.end)],
            "transl": [("start_transl", self.start_transl), ("end_transl", self.end_transl)],
        }
