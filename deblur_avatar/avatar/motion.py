"""How a body moves while the shutter is open: one trajectory module a choice.

Conventions. `u` in [0, 1] is time within one exposure. A trajectory answers, for one frame, with
the joints' unit quaternions relative to their parents and the translation at each of its S
instants. F frames, J joints. Every frame of the clip has a row; only those that are trained move.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deblur_avatar.artifacts import Motion, Poses
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_to_axis_angle,
    quat_to_matrix,
    slerp,
)
from deblur_avatar.geometry.splines import fit_knots, spline_points, spline_quats


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
        """The poses of one exposure."""
        raise NotImplementedError

    def to_artifact(self, betas: Tensor, timestamps: Tensor) -> Motion:
        """Sample every exposure, and keep the unknowns so that a later stage can go on."""
        with torch.no_grad():
            frames = [self(index) for index in range(len(timestamps))]
        quats = torch.stack([frame.quats for frame in frames]).cpu()
        transl = torch.stack([frame.transl for frame in frames]).cpu()
        middle = quat_to_axis_angle(torch.stack([frame.centre_quats for frame in frames]).cpu())
        axis_angle = quat_to_axis_angle(quats)
        return Motion(
            kind=self.kind,
            u=self.u.cpu(),
            timestamps=timestamps,
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
        self.axis_angle = nn.Parameter(_axis_angle(poses), requires_grad=refined)
        self.transl = nn.Parameter(poses.transl.clone(), requires_grad=refined)

    def forward(self, frame: int) -> Instants:
        """The frame's one pose."""
        quats, transl = axis_angle_to_quat(self.axis_angle[frame]), self.transl[frame]
        return Instants(quats[None], transl[None], quats, transl)


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
        given = _axis_angle(poses)
        noise = torch.randn(given.shape, generator=generator, device=given.device)
        noise = noise * start_noise / 2
        noise[:, 0] = 0  # the root parts by itself once the limbs have
        self.start = nn.Parameter(given + noise)
        self.end = nn.Parameter(given - noise)
        self.start_transl = nn.Parameter(poses.transl.clone())
        self.end_transl = nn.Parameter(poses.transl.clone())

    def forward(self, frame: int) -> Instants:
        """Virtual poses between start (u = 0) and end (u = 1)."""
        u = torch.cat([self.u, self.u.new_tensor([0.5])])
        quats = slerp(axis_angle_to_quat(self.start[frame]), axis_angle_to_quat(self.end[frame]), u)
        start, end = self.start_transl[frame], self.end_transl[frame]
        transl = start + u[:, None] * (end - start)
        return Instants(quats[:-1], transl[:-1], quats[-1], transl[-1])


class ClipMotion(Trajectory):
    """One smooth trajectory for the whole clip, of which every exposure is a piece.

    Neighbouring frames say which way a limb moves, exposures may overlap or leave gaps, and frames
    that were never fitted lie on the curve too. Knots start as the smoothest curve near the given
    poses.

    Source: design of this project, after continuous-time trajectories (BAD-Gaussians; Casual3DHDR).
    """

    kind = "clip"
    times: Tensor

    def __init__(
        self,
        u: Float[Tensor, " S"],
        times: Float[Tensor, "F S_and_1"],
        axis_angle: Float[Tensor, "K J 3"],
        transl: Float[Tensor, "K 3"],
    ) -> None:
        """Take knots, and when each frame's instants and middle are, in units of their spacing."""
        super().__init__()
        self.register_buffer("u", u, persistent=False)
        self.register_buffer("times", times)
        self.axis_angle = nn.Parameter(axis_angle)
        self.transl = nn.Parameter(transl)

    @classmethod
    def near(
        cls,
        poses: Poses,
        u: Float[Tensor, " S"],
        timestamps: Float[Tensor, " F"],
        exposure: float,
        knot_spacing: float,
        smoothness: float,
    ) -> "ClipMotion":
        """The smoothest curve near given poses; exposure and knot spacing in seconds."""
        first = float(timestamps[0]) - exposure / 2
        span = float(timestamps[-1]) + exposure / 2 - first
        count = max(round(span / knot_spacing) + 1, 2)
        spacing = span / (count - 1)
        inside = torch.cat([u, u.new_tensor([0.5])])
        times = (timestamps[:, None] + (inside - 0.5) * exposure - first) / spacing
        quats = _continuous(axis_angle_to_quat(_axis_angle(poses)))
        knots = fit_knots(quats.flatten(1), times[:, -1], count, smoothness).unflatten(1, (-1, 4))
        axis_angle = quat_to_axis_angle(nn.functional.normalize(knots, dim=-1))
        return cls(u, times, axis_angle, fit_knots(poses.transl, times[:, -1], count, smoothness))

    def forward(self, frame: int) -> Instants:
        """The piece of the trajectory that one exposure sees."""
        quats = spline_quats(axis_angle_to_quat(self.axis_angle), self.times[frame])
        transl = spline_points(self.transl, self.times[frame])
        return Instants(quats[:-1], transl[:-1], quats[-1], transl[-1])


def _continuous(quats: Float[Tensor, "F J 4"]) -> Float[Tensor, "F J 4"]:
    """Choose, of the two quaternions of each rotation, the one nearer to the frame before."""
    flips = torch.where((quats[1:] * quats[:-1]).sum(-1) < 0, -1.0, 1.0)
    signs = torch.cat([torch.ones_like(flips[:1]), flips]).cumprod(0)
    return quats * signs[..., None]


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


def trajectory_from_artifact(motion: Motion) -> Trajectory:
    """Rebuild the trajectory that a stage saved.

    Raises:
        ArtifactError: if it is of a kind that this version does not know.
    """
    if motion.kind == "pair":
        generator = torch.Generator()
        trajectory: Trajectory = PairMotion(motion.centre, motion.u, 0.0, generator)
    elif motion.kind == "clip":
        return ClipMotion(motion.u, **{k: v.clone() for k, v in motion.parameters.items()})
    elif motion.kind in ("frame", "fixed"):
        trajectory = FrameMotion(motion.centre, refined=motion.kind == "frame")
    else:
        raise ArtifactError(f"no motion of kind {motion.kind!r} is known; run `dvc repro`")
    with torch.no_grad():
        for name, value in motion.parameters.items():
            getattr(trajectory, name).copy_(value)
    return trajectory


def _axis_angle(poses: Poses) -> Tensor:
    return torch.cat([poses.global_orient[:, None], poses.body_pose], dim=1)
