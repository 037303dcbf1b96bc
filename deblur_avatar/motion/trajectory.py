"""How a body moves while the shutter is open: one trajectory module a choice.

Conventions. `u` in [0, 1] is time within one exposure. A trajectory answers, for one frame, with
the joints' unit quaternions relative to their parents and the translation at each of its S
instants. F frames, J joints. Every frame of the clip has a row; only those that are trained move.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_to_axis_angle,
    quat_to_matrix,
    slerp,
)


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


class Trajectory(nn.Module):
    """What every choice of motion offers; abstract."""

    kind: str
    u: Tensor

    def forward(self, frame: int) -> Instants:
        """The poses of one exposure at the instants that fitting takes."""
        return self.at(frame, self.u)

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """The poses of one exposure at any instants."""
        raise NotImplementedError

    def priors(self) -> dict[str, Float[Tensor, ""]]:
        """What is known of such motion beforehand, as named penalties without weights."""
        return {}

    def first(self, frame: int) -> Instants | None:
        """The middle of one exposure as it was before fitting, where that is remembered."""
        return None

    def counts(self, frames: int) -> Int64[Tensor, " F"]:
        """How many instants fitting takes of each exposure."""
        return torch.full((frames,), len(self.u))

    def estimated_shutter(self, timestamps: Float[Tensor, " F"]) -> float | None:
        """How long the shutter was open, seconds, where that was an unknown of the motion."""
        return None

    @torch.no_grad()
    def to_artifact(self, betas: Tensor, timestamps: Tensor) -> Motion:
        """Sample every exposure, and keep the unknowns so that a later stage can go on."""
        frames = [self.at(index, self.u) for index in range(len(timestamps))]
        quats = torch.stack([frame.quats for frame in frames]).cpu()
        transl = torch.stack([frame.transl for frame in frames]).cpu()
        middle = quat_to_axis_angle(torch.stack([frame.centre_quats for frame in frames]).cpu())
        axis_angle = quat_to_axis_angle(quats)
        return Motion(
            kind=self.kind,
            u=self.u.cpu(),
            timestamps=timestamps,
            counts=self.counts(len(timestamps)).cpu(),
            shutter=self.estimated_shutter(timestamps),
            global_orient=axis_angle[:, :, 0],
            body_pose=axis_angle[:, :, 1:],
            transl=transl,
            centre=Poses(
                betas=betas.cpu(),
                global_orient=middle[:, 0],
                body_pose=middle[:, 1:],
                transl=torch.stack([frame.centre_transl for frame in frames]).cpu(),
            ),
            # Clones: fitting works in place, and an artifact never changes.
            parameters={name: value.cpu().clone() for name, value in self.state_dict().items()},
        )


class FrameMotion(Trajectory):
    """One pose a frame: the body stands still during the exposure.

    `refined` poses are unknowns (3DGS-Avatar's pose correction), otherwise they stay as given.
    """

    def __init__(self, poses: Poses, *, refined: bool) -> None:
        super().__init__()
        self.kind = "frame" if refined else "fixed"
        self.register_buffer("u", torch.tensor([0.5]), persistent=False)
        self.axis_angle = nn.Parameter(stacked_axis_angle(poses), requires_grad=refined)
        self.transl = nn.Parameter(poses.transl.clone(), requires_grad=refined)

    def at(self, frame: int, u: Float[Tensor, " S"]) -> Instants:
        """The frame's one pose, at every instant."""
        quats, transl = axis_angle_to_quat(self.axis_angle[frame]), self.transl[frame]
        return Instants(quats.expand(len(u), -1, -1), transl.expand(len(u), -1), quats, transl)


class PairMotion(Trajectory):
    """A start and an end pose a frame, joined along the shortest arcs.

    Source: Deblur-Avatar (arXiv 2501.13335) sec. III-B. Equal start and end poses are a saddle
    point with equal gradients, so they are parted by noise: half of it forward and half back, so
    that the middle stays the given pose (the authors' code disturbs the start alone).
    """

    kind = "pair"

    def __init__(
        self, poses: Poses, u: Tensor, start_noise: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.register_buffer("u", u, persistent=False)
        given = stacked_axis_angle(poses)
        noise = torch.randn(given.shape, generator=generator, device=given.device)
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


def instants(count: int, quadrature: str) -> Float[Tensor, " S"]:
    """Where in the exposure `count` virtual poses stand.

    `endpoints` includes both ends, as the paper does; `midpoints` are the middles of equal parts,
    which do not shorten the motion that explains a blur by (count - 1) / count.
    """
    if count == 1:
        return torch.tensor([0.5])
    if quadrature == "endpoints":
        return torch.linspace(0, 1, count)
    return (torch.arange(count) + 0.5) / count


def stacked_axis_angle(poses: Poses) -> Float[Tensor, "F J 3"]:
    """Rotations of all joints relative to their parents, the root's first."""
    return torch.cat([poses.global_orient[:, None], poses.body_pose], dim=1)
