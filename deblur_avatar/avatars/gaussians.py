"""Gaussians that dress a body: where they start and what is stored of them.

Conventions. What is optimised is unconstrained (`log_scales`, `opacity_logits`, raw `quats`); what
is rendered is derived from it. Canonical space, metres, quaternions wxyz.
"""

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from deblur_avatar.geometry.nearest import nearest

# Not parameters: 3DGS's first values (Kerbl et al. 2023), which fitting leaves in a few steps.
FIRST_OPACITY = 0.1
SCALE_NEIGHBOURS = 3  # a Gaussian starts as wide as it is far from these many others
SMALLEST_SPACING = 1e-7  # square metres


class Gaussians(nn.Module):
    """The optimised parameters of N canonical Gaussians."""

    def __init__(
        self,
        means: Float[Tensor, "N 3"],
        quats: Float[Tensor, "N 4"],
        log_scales: Float[Tensor, "N 3"],
        opacity_logits: Float[Tensor, " N"],
        features: Float[Tensor, "N D"],
    ) -> None:
        super().__init__()
        self.means = nn.Parameter(means)
        self.quats = nn.Parameter(quats)
        self.log_scales = nn.Parameter(log_scales)
        self.opacity_logits = nn.Parameter(opacity_logits)
        self.features = nn.Parameter(features)

    @property
    def scales(self) -> Float[Tensor, "N 3"]:
        """Standard deviations, metres."""
        return self.log_scales.exp()

    @property
    def opacities(self) -> Float[Tensor, " N"]:
        """Peak opacities in (0, 1)."""
        return self.opacity_logits.sigmoid()

    def __len__(self) -> int:
        return len(self.means)


def gaussians_on_surface(
    vertices: Float[Tensor, "V 3"],
    faces: Int64[Tensor, "T 3"],
    count: int,
    features: int,
    generator: torch.Generator,
) -> Gaussians:
    """Spread Gaussians evenly over a mesh, as wide as they are apart.

    Args:
        vertices: canonical positions, metres.
        faces: triangles.
        count: how many.
        features: appearance numbers of each, zero at first.
        generator: of the random positions.
    """
    means = sample_surface(vertices, faces, count, generator)[0]
    squared = neighbour_distances(means, SCALE_NEIGHBOURS).square().mean(1)
    log_scales = squared.clamp(min=SMALLEST_SPACING).sqrt().log()[:, None].repeat(1, 3)
    quats = means.new_tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1)
    opacity = means.new_full((count,), FIRST_OPACITY).logit()
    return Gaussians(means, quats, log_scales, opacity, means.new_zeros(count, features))


def sample_surface(
    vertices: Float[Tensor, "V 3"],
    faces: Int64[Tensor, "T 3"],
    count: int,
    generator: torch.Generator,
    areas: Float[Tensor, " T"] | None = None,
) -> tuple[Float[Tensor, "N 3"], Int64[Tensor, " N"], Float[Tensor, "N 3"]]:
    """Draw points uniformly over a mesh: positions, triangles, barycentric coordinates.

    Args:
        vertices: positions, metres.
        faces: triangles.
        count: how many points.
        generator: of the random positions.
        areas: the triangles' `face_areas`, where the caller has them.
    """
    areas = face_areas(vertices, faces) if areas is None else areas
    chosen = torch.multinomial(areas.cpu(), count, replacement=True, generator=generator)
    chosen = chosen.to(areas.device)
    uv = torch.rand(count, 2, generator=generator, dtype=vertices.dtype).to(vertices)
    root = uv[:, :1].sqrt()
    weights = torch.cat([1 - root, root * (1 - uv[:, 1:]), root * uv[:, 1:]], dim=1)
    return (weights[..., None] * vertices[faces[chosen]]).sum(1), chosen, weights


def face_areas(vertices: Float[Tensor, "V 3"], faces: Int64[Tensor, "T 3"]) -> Float[Tensor, " T"]:
    """Areas of triangles, square metres, times two."""
    corners = vertices[faces]
    edges = corners[:, 1:] - corners[:, :1]
    return torch.linalg.cross(edges[:, 0], edges[:, 1]).norm(dim=-1)


def neighbour_indices(points: Float[Tensor, "N 3"], count: int) -> Int64[Tensor, "N K"]:
    """The `count` nearest other points of each point."""
    index = nearest(points, points, count + 1).indices
    # Clones lie in one place: a point need not come first among those nearest to it, or at all.
    others = index != torch.arange(len(points), device=points.device)[:, None]
    others[others.all(1), -1] = False
    return index[others].reshape(len(points), -1)


def neighbour_distances(points: Float[Tensor, "N 3"], count: int) -> Float[Tensor, "N K"]:
    """Distances to the `count` nearest other points, metres."""
    return (points[neighbour_indices(points, count)] - points[:, None]).norm(dim=-1)
