"""Upright: from the world that a person was filmed in to the axes that other programs expect.

Conventions. The person faces +Z and stands on y = 0, +Y up, metres; the origin lies below where she
was on average. Programs that show splats have +Y down and look along +Z, which is half a turn about
X away.
"""

import dataclasses
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed, shaped_joints
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.posed_gaussians import PosedGaussians
from deblur_avatar.geometry.rotations import axis_angle_to_quat, matrix_to_quat, quat_multiply

HALF_TURN = torch.diag(torch.tensor([1.0, -1.0, -1.0]))  # splats_from_upright


@dataclass(frozen=True)
class Upright:
    """`upright = rotation @ (world - origin)`."""

    rotation: Float[Tensor, "3 3"]
    origin: Float[Tensor, " 3"]

    def points(self, world: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
        """Take points along."""
        return (world - self.origin) @ self.rotation.T

    def gaussians(self, world: PosedGaussians) -> PosedGaussians:
        """Take Gaussians along."""
        turn = matrix_to_quat(self.rotation).expand_as(world.quats)
        return dataclasses.replace(
            world, means=self.points(world.means), quats=quat_multiply(turn, world.quats)
        )

    def pose(
        self, poses: Poses, pelvis: Float[Tensor, " 3"]
    ) -> tuple[Float[Tensor, "F J 4"], Float[Tensor, "F 3"]]:
        """Local rotations (wxyz) of all joints, the root's turned along, and the root's places.

        Args:
            poses: in the world.
            pelvis: the root's rest position.
        """
        quats = axis_angle_to_quat(poses.axis_angle)
        turn = matrix_to_quat(self.rotation).expand_as(quats[:, 0])
        root = quat_multiply(turn, quats[:, 0])
        return torch.cat([root[:, None], quats[:, 1:]], dim=1), self.points(pelvis + poses.transl)

    def for_splats(self) -> "Upright":
        """The same with +Y down."""
        return Upright(HALF_TURN @ self.rotation, self.origin)


def upright_of(run: FittedRun) -> Upright:
    """The axes of the person of a run.

    Raises:
        ConfigError: if the camera looked along the person's vertical.
    """
    rotation = run.stage.world_from_stage.T
    moved = dataclasses.replace(run.motion.centre, betas=run.avatar.betas)
    joints = posed(run.observations.body, moved).joints
    pelvis = joints[:, 0].mean(0)
    floor = ((joints - pelvis) @ rotation.T)[..., 1].min()
    return Upright(rotation, pelvis + floor * rotation[1])


def rest_pelvis(run: FittedRun) -> Float[Tensor, " 3"]:
    """The root's rest position, of the body that was fitted."""
    return shaped_joints(run.observations.body, run.avatar.betas)[0]
