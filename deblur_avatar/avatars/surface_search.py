"""Where rays meet the surface of a posed signed distance field, and where samples are worth it.

A ray is first followed by steps as long as the distance where it is, then point and depth are found
together: the canonical point is on the surface, and skinning moves it onto the ray.

Conventions. World coordinates, metres; no gradients. Q rays, K samples a ray, P points.

Source: ARAH, Wang et al., ECCV 2022, sec. 3.3, with fewer samples.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.avatars.forward_skinning import (
    GIVEN_UP,
    ITERATIONS,
    TOLERANCE,
    ForwardSkinning,
)
from deblur_avatar.config.section import Count, Params, Positive
from deblur_avatar.geometry.root_finding import broyden
from deblur_avatar.rendering.volume_rendering import Rays, sample_depths

# Not parameters: of the search, of which every picture is made alike.
STEPS = 16  # along a ray
LONGEST_STEP = 0.1  # metres, of them
CLOSE = 0.02  # metres, from where point and depth are found together
REACH = 0.1  # metres from the body within which there can be a surface
LAST_LENGTH = 1 / 64  # metres, of a ray's last sample: the release's

# Of canonical points from the surface.
Distances = Callable[[Float[Tensor, "P 3"]], Float[Tensor, " P"]]


class SamplesParams(Params):
    """How many samples a ray has, and where."""

    near: Count  # around the surface that it meets
    front: Count  # from where it comes to there
    free: Count  # of a ray that meets none
    band_m: Positive  # half of how far those around the surface reach


@dataclass(frozen=True)
class Surface:
    """Depths at which rays meet the surface, and which of them do."""

    depths: Float[Tensor, " Q"]
    met: Bool[Tensor, " Q"]


@torch.no_grad()
def near_body(rays: Rays, skinning: ForwardSkinning, count: int) -> Bool[Tensor, " Q"]:
    """Rays that come near a posed vertex; others see nothing.

    Args:
        rays: cut to where the body is.
        skinning: of the instant.
        count: of places along each ray that are asked.
    """
    depths = sample_depths(rays.near, rays.far, count)
    apart, _ = skinning.nearest(rays.at(depths).flatten(0, 1))
    spacing = (rays.far - rays.near) / count
    return apart.unflatten(0, depths.shape).amin(1) < REACH + spacing / 2


@torch.no_grad()
def met_surface(rays: Rays, skinning: ForwardSkinning, distances: Distances) -> Surface:
    """Find where rays first meet the surface.

    Args:
        rays: that come near the body.
        skinning: of the instant.
        distances: of canonical points.
    """
    depths, left = _followed(rays, skinning, distances)
    rows = (left.abs() < CLOSE).nonzero()[:, 0]
    met = torch.zeros_like(left, dtype=torch.bool)
    if len(rows):
        part = rays.part(left.abs() < CLOSE)
        found, sure = _together(part, depths[rows], skinning, distances)
        depths[rows], met[rows] = found, sure
    return Surface(depths, met)


def _followed(
    rays: Rays, skinning: ForwardSkinning, distances: Distances
) -> tuple[Float[Tensor, " Q"], Float[Tensor, " Q"]]:
    """Sphere tracing with the nearest vertices' transforms: depths, and the distances there."""
    depths, left = rays.near.clone(), torch.full_like(rays.near, torch.inf)
    going = torch.arange(len(rays), device=depths.device)
    for _ in range(STEPS):
        points = rays.origins[going] + depths[going, None] * rays.directions[going]
        apart, vertices = skinning.nearest(points)
        places, _ = skinning.near_vertices(points, vertices)
        found = distances(places)
        # Far from the body the field was never asked; vertices are a bound there.
        found = torch.where(apart > REACH, apart - REACH / 2, found)
        left[going] = found
        moves = (found.abs() > GIVEN_UP) & (depths[going] < rays.far[going])
        if not moves.any():
            break
        going = going[moves]
        depths[going] += found[moves].clamp(-LONGEST_STEP, LONGEST_STEP)
    return depths, torch.where(depths < rays.far, left, torch.full_like(left, torch.inf))


def _together(
    rays: Rays, depths: Tensor, skinning: ForwardSkinning, distances: Distances
) -> tuple[Float[Tensor, " A"], Bool[Tensor, " A"]]:
    """Broyden's method for a canonical point and a depth at once."""
    points = rays.origins + depths[:, None] * rays.directions
    _, vertices = skinning.nearest(points)
    places, inverse = skinning.near_vertices(points, vertices)
    gradients = _gradients(distances, places)
    count = len(points)
    jacobian = points.new_zeros(count, 4, 4)
    jacobian[:, 0, :3] = gradients
    jacobian[:, 1:, :3] = torch.linalg.inv_ex(inverse)[0]
    jacobian[:, 1:, 3] = -rays.directions
    inverse, failed = torch.linalg.inv_ex(jacobian)
    usable = (failed == 0) & torch.isfinite(inverse).all(2).all(1)
    inverse = torch.where(usable[:, None, None], inverse, torch.zeros_like(inverse))

    def equations(values: Tensor, rows: Tensor) -> Tensor:
        on_rays = rays.origins[rows] + values[:, 3:] * rays.directions[rows]
        apart = skinning.skinned(values[:, :3]) - on_rays
        return torch.cat([distances(values[:, :3])[:, None], apart], dim=1)

    start = torch.cat([places, depths[:, None]], dim=1)
    roots = broyden(equations, start, inverse, ITERATIONS, TOLERANCE)
    found = roots.values[:, 3]
    sure = (roots.residuals < GIVEN_UP) & (found > rays.near) & (found < rays.far)
    return torch.where(sure, found, depths), sure


def _gradients(distances: Distances, points: Tensor) -> Float[Tensor, "P 3"]:
    with torch.enable_grad():
        places = points.detach().requires_grad_()
        return torch.autograd.grad(distances(places).sum(), places)[0]


def placed_samples(
    rays: Rays, surface: Float[Tensor, " Q"], params: SamplesParams,
    generator: torch.Generator | None,
) -> Float[Tensor, "Q K"]:  # fmt: skip
    """Depths of samples of rays that meet the surface: few in front, most around it.

    Args:
        rays: all of which meet it.
        surface: depths where they do.
        params: how many, and where.
        generator: draws them; None for the same ones each time.
    """
    begin = (surface - params.band_m).clamp(min=rays.near)
    front = sample_depths(rays.near, begin, params.front, generator)
    around = sample_depths(begin, surface + params.band_m, params.near, generator)
    return torch.cat([front, around], dim=1)


def sample_lengths(depths: Float[Tensor, "Q K"]) -> Float[Tensor, "Q K"]:
    """How much of its ray each sample stands for: to the next."""
    last = torch.full_like(depths[:, :1], LAST_LENGTH)
    return torch.cat([depths.diff(dim=1), last], dim=1)
