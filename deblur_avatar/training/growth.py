"""Growth: every Gaussian becomes several narrower ones, where fitting goes on to larger pictures.

Conventions. Canonical space, metres. Children lie about their parent as its own density does and
share its area, so that the picture stays what it was; their rows follow a Morton curve, so that
neighbours in space are neighbours in memory.
"""

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.optim import Optimizer

from deblur_avatar.avatars.gaussians import Gaussians
from deblur_avatar.geometry.rotations import quat_to_matrix
from deblur_avatar.training.densify import replace_gaussians

# Not a parameter: children at a parent's own standard deviation would widen it by two fifths.
SPREAD = 0.8  # of the parent's standard deviation
MORTON_BITS = 10  # of each coordinate: cells of a few millimetres


def multiply_gaussians(
    gaussians: Gaussians, optimizer: Optimizer, count: int, generator: torch.Generator
) -> None:
    """Make `count` Gaussians of fewer; the optimizer forgets them all.

    Source: the idea of growing by splitting all at once is DashGaussian's (CVPR 2025); the law of
    children is ours.
    """
    own = len(gaussians)
    if count <= own:
        return
    with torch.no_grad():
        parent = torch.arange(count, device=gaussians.means.device) * own // count
        children = torch.bincount(parent, minlength=own)[parent]
        split = {name: value.data[parent] for name, value in gaussians.named_parameters()}
        scales = split["log_scales"].exp()
        draws = torch.randn(scales.shape, generator=generator).to(scales)
        offset = (quat_to_matrix(split["quats"]) @ (SPREAD * scales * draws)[..., None])[..., 0]
        several = (children > 1)[:, None]
        split["means"] = torch.where(several, split["means"] + offset, split["means"])
        split["log_scales"] = split["log_scales"] - 0.5 * children[:, None].log()
        order = morton_codes(split["means"]).argsort(stable=True)
        split = {name: value[order] for name, value in split.items()}
        none = torch.zeros(own, dtype=torch.bool, device=parent.device)
    replace_gaussians(gaussians, optimizer, none, [split])
    for value in gaussians.parameters():
        optimizer.state.pop(value, None)


def morton_codes(points: Float[Tensor, "N 3"]) -> Int64[Tensor, " N"]:
    """Where points lie along a Morton (z-order) curve through their box."""
    low, high = points.amin(0), points.amax(0)
    cells = (2**MORTON_BITS - 1) * (points - low) / (high - low).clamp(min=1e-9)
    codes = torch.zeros(len(points), dtype=torch.int64, device=points.device)
    for bit in range(MORTON_BITS):
        for axis, cell in enumerate(cells.long().unbind(1)):
            codes |= (cell >> bit & 1) << (3 * bit + axis)
    return codes
