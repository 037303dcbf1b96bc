"""Volume rendering: light gathered along rays through matter that is more or less dense.

Conventions. A ray is origin + depth * direction, the direction of unit length, depths in metres.
Densities are per metre. A sample's *opacity* is the share of the light behind it that it keeps
back. Light is premultiplied by coverage. Q rays, K samples a ray.

Source: Max, "Optical Models for Direct Volume Rendering", IEEE TVCG 1995, in the discrete form of
NeRF (Mildenhall et al., ECCV 2020, eq. 3).
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

# Not a parameter: a direction that is nearer to a face of the box than this runs along it.
SMALLEST_SLOPE = 1e-9


@dataclass(frozen=True)
class Rays:
    """Rays in the world, and between which depths something may be met."""

    origins: Float[Tensor, "Q 3"]
    directions: Float[Tensor, "Q 3"]
    near: Float[Tensor, " Q"]
    far: Float[Tensor, " Q"]

    def __len__(self) -> int:
        return len(self.origins)

    def at(self, depths: Float[Tensor, "Q K"]) -> Float[Tensor, "Q K 3"]:
        """Points on the rays."""
        return self.origins[:, None] + depths[..., None] * self.directions[:, None]

    def part(self, chosen: slice | Bool[Tensor, " Q"] | Int64[Tensor, " P"]) -> "Rays":
        """Some of the rays."""
        return Rays(
            self.origins[chosen], self.directions[chosen], self.near[chosen], self.far[chosen]
        )


def box_depths(
    origins: Float[Tensor, "Q 3"],
    directions: Float[Tensor, "Q 3"],
    low: Float[Tensor, " 3"],
    high: Float[Tensor, " 3"],
) -> tuple[Float[Tensor, " Q"], Float[Tensor, " Q"]]:
    """Depths at which rays enter and leave a box; one that misses it does not leave after entering.

    Source: Kay and Kajiya, "Ray Tracing Complex Scenes", SIGGRAPH 1986: slabs.
    """
    along = directions.abs() < SMALLEST_SLOPE
    slopes = torch.where(along, torch.full_like(directions, SMALLEST_SLOPE), directions)
    first, second = (low - origins) / slopes, (high - origins) / slopes
    near = torch.minimum(first, second).amax(1).clamp(min=0)
    return near, torch.maximum(first, second).amin(1)


def sample_depths(
    near: Float[Tensor, " Q"],
    far: Float[Tensor, " Q"],
    count: int,
    generator: torch.Generator | None = None,
) -> Float[Tensor, "Q K"]:
    """One depth in each of `count` equal parts of every ray, in ascending order.

    Args:
        near: where the first part begins.
        far: where the last one ends.
        count: K.
        generator: draws where in its part each depth is; None for the parts' middles.
    """
    starts = torch.arange(count, dtype=near.dtype, device=near.device)
    within = starts.new_tensor(0.5)
    if generator is not None:
        within = torch.rand(len(near), count, generator=generator, dtype=near.dtype).to(near)
    return near[:, None] + (far - near)[:, None] * ((starts + within) / count)


def opacity(
    densities: Float[Tensor, "*batch"], lengths: Float[Tensor, "*#batch"]
) -> Float[Tensor, "*batch"]:
    """Share of the light that matter of these densities keeps back over these lengths."""
    return -torch.expm1(-densities * lengths)


def composite(
    opacities: Float[Tensor, "Q K"], colors: Float[Tensor, "Q K 3"]
) -> tuple[Float[Tensor, "Q 3"], Float[Tensor, " Q"]]:
    """Light and coverage of rays, whose samples come from front to back."""
    weights = sample_weights(opacities)
    return (weights[..., None] * colors).sum(1), weights.sum(1)


def sample_weights(opacities: Float[Tensor, "Q K"]) -> Float[Tensor, "Q K"]:
    """How much of each sample is seen: its opacity, times what those in front let through."""
    through = torch.cumprod(1 - opacities, dim=1)
    before = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], dim=1)
    return before * opacities
