"""Body shape and poses (SMPL's betas, global_orient, body_pose, transl)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float, Float32
from torch import Tensor

from deblur_avatar.artifacts.storage import Artifact
from deblur_avatar.geometry.pose_interpolation import interpolated


@dataclass(frozen=True, kw_only=True)
class Poses(Artifact):
    """One body's shape, and its pose at F instants (SMPL's meaning, axis-angle)."""

    schema: ClassVar[str] = "poses/1"

    betas: Float32[Tensor, " B"]
    global_orient: Float32[Tensor, "F 3"]
    body_pose: Float32[Tensor, "F K 3"]  # K = J - 1
    transl: Float32[Tensor, "F 3"]

    @property
    def axis_angle(self) -> Float[Tensor, "F J 3"]:
        """Rotations of all joints relative to their parents, the root's first."""
        return torch.cat([self.global_orient[:, None], self.body_pose], dim=1)

    def at(self, frames: slice | Sequence[int] | Tensor) -> "Poses":
        """Pick some of the instants."""
        index = frames if isinstance(frames, slice) else torch.as_tensor(frames, dtype=torch.long)
        return Poses(
            betas=self.betas,
            global_orient=self.global_orient[index],
            body_pose=self.body_pose[index],
            transl=self.transl[index],
        )

    def at_times(self, known: Float[Tensor, " F"], wanted: Float[Tensor, " S"]) -> "Poses":
        """Poses at any times (`interpolated`), where those of the instants are `known`."""
        turned, transl = interpolated(self.axis_angle, self.transl, known, wanted)
        return Poses(
            betas=self.betas, global_orient=turned[:, 0], body_pose=turned[:, 1:], transl=transl
        )
