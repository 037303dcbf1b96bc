"""A parametric body: vertices, joints, linear blend skinning weights.

Dimensions. F frames, C cameras, R recorded cameras, V test views, J joints, B shape numbers,
P body vertices, T triangles, N Gaussians, S instants inside one exposure.
"""

from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float32, Int64
from torch import Tensor

from deblur_avatar.artifacts.storage import Artifact

SMPL_JOINT_NAMES = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2",
    "left_ankle", "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar",
    "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
SMPL_PARENTS = (
    -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Body(Artifact):
    """A person without clothes who can be shaped and posed. Made by `body`.

    Rest pose: SMPL's T-pose, +Y up, facing +Z, the left hand towards +X, joint frames aligned with
    the world. `pose_dirs` act on rotation matrices minus identity, joints 1 to J-1, row-major.
    """

    schema: ClassVar[str] = "body/1"

    vertices: Float32[Tensor, "P 3"]
    shape_dirs: Float32[Tensor, "P 3 B"]
    joints: Float32[Tensor, "J 3"]
    joint_dirs: Float32[Tensor, "J 3 B"]
    pose_dirs: Float32[Tensor, "P 3 D"] | None
    parents: tuple[int, ...]
    lbs_weights: Float32[Tensor, "P J"]
    faces: Int64[Tensor, "T 3"]
    uvs: Float32[Tensor, "T 3 2"] | None
    joint_names: tuple[str, ...]
    licence: str

    def validate(self) -> None:
        """Refuse trees that are not ordered, weights that do not sum to 1, faces out of range."""
        count = len(self.joints)
        if not count or not len(self.vertices):
            raise ValueError("a body has vertices and joints")
        if len(self.parents) != count or not all(-1 <= p < j for j, p in enumerate(self.parents)):
            raise ValueError(f"parents must name {count} joints, each after its parent")
        if (self.lbs_weights.sum(1) - 1).abs().max() > 1e-3 or self.lbs_weights.min() < 0:
            raise ValueError("lbs_weights must be non-negative with rows that sum to 1")
        if self.faces.numel() and not 0 <= self.faces.min() <= self.faces.max() < len(
            self.vertices
        ):
            raise ValueError("faces must index vertices")
        if self.pose_dirs is not None and self.pose_dirs.shape[2] != 9 * (count - 1):
            raise ValueError(f"pose_dirs must have {9 * (count - 1)} directions")
