"""A fitted trajectory, sampled inside every exposure.

Dimensions. F frames, C cameras, R recorded cameras, V test views, J joints, B shape numbers,
P body vertices, T triangles, N Gaussians, S instants inside one exposure.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float32, Int64
from torch import Tensor

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.storage import Artifact

# What the parameters of a trajectory are called on disk, where the code has another name.
NAMES_ON_DISK = {
    "samples_per_frame": "taken",
    "initial_axis_angle": "first_axis_angle",
    "initial_transl": "first_transl",
}
_NAMES_IN_CODE = {there: here for here, there in NAMES_ON_DISK.items()}


@dataclass(frozen=True, kw_only=True)
class Motion(Artifact):
    """How the body moved while the shutter was open, at instants `u` of every exposure.

    `centre` is the pose that a sharp picture of each frame is rendered with; `num_samples` are how
    many instants of each exposure fitting took. `parameters` hold the unknowns of the trajectory
    `kind` so that a later stage can go on.
    """

    schema: ClassVar[str] = "motion/2"
    names_on_disk: ClassVar[Mapping[str, str]] = {"num_samples": "counts"}

    kind: str
    u: Float32[Tensor, " S"]  # in [0, 1], 0 when the shutter opens
    timestamps: Float32[Tensor, " F"]
    num_samples: Int64[Tensor, " F"]
    shutter: float | None  # seconds it was open, where the motion estimated that
    global_orient: Float32[Tensor, "F S 3"]
    body_pose: Float32[Tensor, "F S K 3"]
    transl: Float32[Tensor, "F S 3"]
    centre: Poses
    parameters: dict[str, Tensor]

    def exposure(self, told: float | None) -> float | None:
        """Seconds the shutter was open: as the motion estimated it, else as the clip told."""
        return self.shutter or told


def named_on_disk(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """A trajectory's tensors by the names that `Motion.parameters` has for them."""
    return {NAMES_ON_DISK.get(name, name): value for name, value in state.items()}


def named_in_code(parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """What `named_on_disk` was given."""
    return {_NAMES_IN_CODE.get(name, name): value for name, value in parameters.items()}
