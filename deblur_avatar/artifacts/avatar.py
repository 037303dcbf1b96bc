"""A fitted avatar: canonical Gaussians and networks.

Dimensions. F frames, C cameras, R recorded cameras, V test views, J joints, B shape numbers,
P body vertices, T triangles, N Gaussians, S instants inside one exposure.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float32
from torch import Tensor

from deblur_avatar.artifacts.storage import Artifact

# What the parts of an avatar are called on disk, where the code has another name.
PARTS_ON_DISK = {
    "deformation": "nonrigid",
    "skinning_field": "skinning",
    "color_network": "color",
}
_PARTS_IN_CODE = {there: here for here, there in PARTS_ON_DISK.items()}
# Compositions of before there were kinds: these parts alone, absent or not.
_PARTS = ("nonrigid", "skinning", "color")
# What compositions say nothing of: they were saved before there was a choice. Equal avatars stay
# equal bytes.
_PRECISION_OF_OLD = "bfloat16"


@dataclass(frozen=True, kw_only=True)
class Avatar(Artifact):
    """Canonical Gaussians, and the networks or grids that deform, skin and colour them.

    `model` tells how to read the rest: `params` is the composition (`composition_on_disk`),
    `frames` how many the clip has, `light` its averaging space. An avatar that is
    not made of Gaussians has none of them, and all else in `networks`.
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


def no_gaussians() -> dict[str, Tensor]:
    """The fields of an avatar that is not made of Gaussians."""
    sizes = {"means": (0, 3), "quats": (0, 4), "log_scales": (0, 3), "features": (0, 0)}
    return {name: torch.zeros(size) for name, size in sizes.items()} | {
        "opacity_logits": torch.zeros(0)
    }


def composition_on_disk(params: Mapping[str, Any]) -> dict[str, Any]:
    """What an avatar is made of, as `Avatar.model` has it; `params` name its kind."""
    said = dict(params)
    if said["kind"] == "plain":
        return dict.fromkeys(_PARTS)
    if said["kind"] == "networks":
        del said["kind"]
        if said["precision"] == _PRECISION_OF_OLD:
            del said["precision"]
    return said


def composition_in_code(said: Mapping[str, Any]) -> dict[str, Any]:
    """What `composition_on_disk` was given."""
    if "kind" in said:
        return dict(said)
    if all(value is None for value in said.values()):
        return {"kind": "plain", **{name: said[name] for name in said.keys() - {*_PARTS}}}
    return {"kind": "networks", "precision": _PRECISION_OF_OLD, **said}


def part_on_disk(name: str) -> str:
    """A tensor's name on disk, whose first word is that of its part."""
    part, _, rest = name.partition(".")
    return ".".join(filter(None, (PARTS_ON_DISK.get(part, part), rest)))


def part_in_code(name: str) -> str:
    """What `part_on_disk` was given."""
    part, _, rest = name.partition(".")
    return ".".join(filter(None, (_PARTS_IN_CODE.get(part, part), rest)))
