"""Edits of a set of Gaussians: which are chosen, and what those that are added are made of.

Conventions. A *part* holds the stored values of some Gaussians, by name. Pulls are mean lengths of
screen gradients, in half image widths.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.avatars.gaussians import Gaussians
from deblur_avatar.geometry.rotations import quat_to_matrix

# Not a parameter: 3DGS's (Kerbl et al. 2023); which are split, DensifyParams' thresholds say.
SPLIT_SHRINK = 1.6  # how much narrower the two halves of a split Gaussian are

Part = dict[str, Tensor]
Edits = tuple[Tensor, list[Part]]  # which Gaussians stay, and what is added


def strongest(pulls: Float[Tensor, " N"], threshold: float, room: int) -> Bool[Tensor, " N"]:
    """The most strongly pulled Gaussians, as many as there is room for."""
    chosen = pulls > threshold
    if int(chosen.sum()) > room:
        order = torch.where(chosen, pulls, torch.zeros_like(pulls)).argsort(descending=True)
        chosen = torch.zeros_like(chosen)
        chosen[order[:room]] = True
    return chosen


def copied(gaussians: Gaussians, chosen: Tensor) -> Part:
    """Stored values of the chosen ones."""
    return {name: value.data[chosen] for name, value in gaussians.named_parameters()}


def drawn_within(part: Part, generator: torch.Generator) -> Part:
    """The same Gaussians, each at a place that is drawn from its own density."""
    scales = part["log_scales"].exp()
    offset = torch.randn(scales.shape, generator=generator).to(scales) * scales
    turned = (quat_to_matrix(part["quats"]) @ offset[..., None])[..., 0]
    return part | {"means": part["means"] + turned}


def halves(gaussians: Gaussians, chosen: Tensor, generator: torch.Generator) -> list[Part]:
    """Two narrower Gaussians within each of the chosen ones."""
    parts = []
    for _ in range(2):
        part = drawn_within(copied(gaussians, chosen), generator)
        part["log_scales"] = (part["log_scales"].exp() / SPLIT_SHRINK).log()
        parts.append(part)
    return parts
