"""A person of capsules, arms held away from the body, as Gaussians: the scene of the benchmarks.

It fills 92 % of the picture's height. A Gaussian is as wide as the mean distance between nearest
neighbours, times a log-normal factor for each axis; rotations, opacities and colours are random.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from scipy.spatial import KDTree
from torch import Tensor

from deblur_avatar.rendering.covariances import covariances, upper_triangles

# Ends and radius of each capsule, metres, y up.
CAPSULES = (
    ((0, 0.95, 0), (0, 1.45, 0), 0.15),  # trunk
    ((0, 1.60, 0), (0, 1.70, 0), 0.10),  # head
    ((0.18, 1.42, 0), (0.62, 0.95, 0), 0.045),  # arms
    ((-0.18, 1.42, 0), (-0.62, 0.95, 0), 0.045),
    ((0.10, 0.90, 0), (0.20, 0.07, 0), 0.07),  # legs
    ((-0.10, 0.90, 0), (-0.20, 0.07, 0), 0.07),
)
DISTANCE = 3.0  # from the camera, metres
FILL = 0.92  # of the picture's height


@dataclass(frozen=True, kw_only=True)
class Person:
    """Arguments of `rasterize`."""

    means: Float[Tensor, "B N 3"]
    covars: Float[Tensor, "B N 6"]
    opacities: Float[Tensor, " N"]
    colors: Float[Tensor, "N 3"]
    viewmat: Float[Tensor, "4 4"]
    K: Float[Tensor, "3 3"]


def capsule_person(gaussians: int, size: int, poses: int, seed: int = 0) -> Person:
    """Make the scene; the poses shift the person by 4 cm in all."""
    generator = torch.Generator().manual_seed(seed)
    points = _surface(gaussians, generator)
    spacing = KDTree(points.numpy()).query(points.numpy(), k=2)[0][:, 1].mean()
    scales = spacing * torch.exp(0.3 * torch.randn(gaussians, 3, generator=generator))
    quats = torch.randn(gaussians, 4, generator=generator)
    covars = upper_triangles(covariances(quats, scales))

    low, high = points.min(0).values, points.max(0).values
    viewmat = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))  # y up to y down
    viewmat[:3, 3] = -viewmat[:3, :3] @ (0.5 * (low + high))
    viewmat[2, 3] += DISTANCE
    focal = FILL * size * DISTANCE / float(high[1] - low[1])
    K = torch.tensor([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    shifts = torch.linspace(-0.02, 0.02, poses)[:, None] if poses > 1 else torch.zeros(1, 1)
    direction = torch.tensor([1.0, 0.3, 0.2])
    return Person(
        means=points + (shifts * direction)[:, None],
        covars=covars.expand(poses, gaussians, 6).contiguous(),
        opacities=0.1 + 0.89 * torch.rand(gaussians, generator=generator),
        colors=torch.rand(gaussians, 3, generator=generator),
        viewmat=viewmat,
        K=K,
    )


def _surface(count: int, generator: torch.Generator) -> Float[Tensor, "N 3"]:
    """Draw points evenly from the capsules' surfaces, in random order."""
    # A capsule's area is that of a cylinder as long as it is from tip to tip (Archimedes).
    lengths = torch.tensor([math.dist(a, b) + 2 * radius for a, b, radius in CAPSULES])
    radii = torch.tensor([radius for _, _, radius in CAPSULES])
    which = torch.multinomial(lengths * radii, count, replacement=True, generator=generator)
    start = torch.tensor([a for a, _, _ in CAPSULES], dtype=torch.float32)[which]
    end = torch.tensor([b for _, b, _ in CAPSULES], dtype=torch.float32)[which]
    radius, length = radii[which], lengths[which] - 2 * radii[which]
    axis = (end - start) / length[:, None]
    along = torch.rand(count, generator=generator) * lengths[which] - radius
    beyond = (along - along.clamp(min=0).minimum(length)) / radius
    ring = radius * (1 - beyond**2).clamp(min=0).sqrt()
    angle = 2 * math.pi * torch.rand(count, generator=generator)
    side = torch.linalg.cross(axis, torch.tensor([[0.0, 0.0, 1.0]]).expand_as(axis))
    side = side / side.norm(dim=-1, keepdim=True)
    other = torch.linalg.cross(axis, side)
    outwards = angle.cos()[:, None] * side + angle.sin()[:, None] * other
    return start + along[:, None] * axis + ring[:, None] * outwards
