"""A fitted avatar: canonical Gaussians and networks.

Dimensions. F frames, C cameras, R recorded cameras, V test views, J joints, B shape numbers,
P body vertices, T triangles, N Gaussians, S instants inside one exposure.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

from jaxtyping import Float32
from torch import Tensor

from deblur_avatar.artifacts.storage import Artifact


@dataclass(frozen=True, kw_only=True)
class Avatar(Artifact):
    """Canonical Gaussians and the networks that dress, skin and colour them.

    `model` is the composition (`config.ModelParams` as JSON) that tells how to read the rest.
    """

    schema: ClassVar[str] = "avatar/1"

    means: Float32[Tensor, "N 3"]  # canonical space
    quats: Float32[Tensor, "N 4"]  # wxyz, not normalised
    log_scales: Float32[Tensor, "N 3"]  # log metres
    opacity_logits: Float32[Tensor, " N"]
    features: Float32[Tensor, "N D"]  # appearance; its meaning is the model's
    betas: Float32[Tensor, " B"]
    networks: dict[str, Tensor]
    model: dict[str, Any]
    iteration: int
