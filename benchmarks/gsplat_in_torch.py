"""gsplat's plain-torch functions, completed so that they render without a GPU.

gsplat 1.5.3 projects and accumulates in torch, as a check of its CUDA kernels. Two things between
exist on a GPU only: the list of which Gaussian meets which pixel, and `nerfacc`, which multiplies
along rays. Both are written here in vectorised torch, the fastest form that we found.
"""

import sys
from types import ModuleType

import torch
from jaxtyping import Float, Int
from torch import Tensor

from deblur_avatar.rendering.conventions import (
    EPS2D,
    MAX_ALPHA,
    MIN_ALPHA,
    MIN_TRANSMITTANCE,
    NEAR_PLANE,
)
from deblur_avatar.rendering.covariances import whole_matrices


def rasterize_by_gsplat(
    means: Float[Tensor, "B N 3"],
    covars: Float[Tensor, "B N 6"],
    opacities: Float[Tensor, " N"],
    colors: Float[Tensor, "N C"],
    viewmat: Float[Tensor, "4 4"],
    K: Float[Tensor, "3 3"],
    width: int,
    height: int,
) -> tuple[Float[Tensor, "1 H W C"], Float[Tensor, "1 H W"]]:
    """Render the mean of B poses over black.

    Raises:
        ImportError: gsplat is not installed.
    """
    sys.modules.setdefault("nerfacc", _nerfacc())
    from gsplat.cuda._torch_impl import _fully_fused_projection, accumulate

    B = len(means)
    radii, means2d, depths, conics, _ = _fully_fused_projection(
        *(means, whole_matrices(covars), viewmat.expand(B, 1, 4, 4), K.expand(B, 1, 3, 3)),
        *(width, height, EPS2D, NEAR_PLANE),
    )
    opacities = opacities.expand(B, 1, -1)
    with torch.no_grad():
        pairs = _pairs(radii[:, 0], means2d[:, 0], depths[:, 0], conics[:, 0], opacities[:, 0])
        poses, gaussians, pixels = _before_pixels_finish(pairs, width, height)
    image, alpha = accumulate(
        *(means2d, conics, opacities, colors.expand(B, 1, *colors.shape)),
        *(gaussians, pixels, poses, width, height),
    )
    return image.mean(0), alpha.mean(0)[..., 0]


Pairs = tuple[Tensor, Tensor, Tensor, Tensor, Tensor]


def _pairs(
    radii: Tensor, means2d: Tensor, depths: Tensor, conics: Tensor, opacities: Tensor
) -> Pairs:
    """List pose, Gaussian, x, y and alpha of all that meet, front to back."""
    poses, gaussians = (radii > 0).all(-1).nonzero(as_tuple=True)
    order = depths[poses, gaussians].argsort(stable=True)
    poses, gaussians = poses[order], gaussians[order]
    centres, reach = means2d[poses, gaussians], radii[poses, gaussians]
    first = (centres - reach - 0.5).ceil().long()
    columns, rows = ((centres + reach - 0.5).floor().long() - first + 1).unbind(-1)
    counts = columns * rows
    owner = torch.repeat_interleave(counts)
    place = torch.arange(len(owner)) - (counts.cumsum(0) - counts)[owner]
    x = first[owner, 0] + place % columns[owner]
    y = first[owner, 1] + place // columns[owner]
    dx, dy = (torch.stack([x, y], -1) + 0.5 - centres[owner]).unbind(-1)
    xx, xy, yy = conics[poses, gaussians][owner].unbind(-1)
    alpha = opacities[poses, gaussians][owner] * torch.exp(
        -0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy
    )
    seen = alpha >= MIN_ALPHA
    alpha = alpha[seen].clamp(max=MAX_ALPHA)
    owner = owner[seen]
    return poses[owner], gaussians[owner], x[seen], y[seen], alpha


def _before_pixels_finish(
    pairs: Pairs, width: int, height: int
) -> tuple[Int[Tensor, " M"], Int[Tensor, " M"], Int[Tensor, " M"]]:
    """Keep what lies in the image and in front of where its pixel is finished, by pixel."""
    poses, gaussians, x, y, alpha = pairs
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    poses, gaussians, x, y, alpha = (t[inside] for t in (poses, gaussians, x, y, alpha))
    pixels = y * width + x
    rays, order = (poses * (width * height) + pixels).sort(stable=True)
    poses, gaussians, pixels, alpha = (t[order] for t in (poses, gaussians, pixels, alpha))
    after = _transmittance(alpha, rays) * (1 - alpha)
    alive = after > MIN_TRANSMITTANCE
    return poses[alive], gaussians[alive], pixels[alive]


def _transmittance(alpha: Float[Tensor, " M"], rays: Int[Tensor, " M"]) -> Float[Tensor, " M"]:
    """Multiply 1 - alpha over what comes earlier on the same ray; rays are sorted."""
    logs = torch.log1p(-alpha.double())
    before = logs.cumsum(0) - logs
    starts = torch.ones_like(rays, dtype=torch.bool)
    starts[1:] = rays[1:] != rays[:-1]
    first = starts.nonzero()[:, 0][starts.cumsum(0) - 1]
    return (before - before[first]).exp().to(alpha)


def _nerfacc() -> ModuleType:
    """Stand in for the two functions of nerfacc that gsplat calls."""

    def render_weight_from_alpha(
        alphas: Tensor, ray_indices: Tensor, n_rays: int
    ) -> tuple[Tensor, Tensor]:
        transmittance = _transmittance(alphas, ray_indices)
        return alphas * transmittance, transmittance

    def accumulate_along_rays(
        weights: Tensor, values: Tensor | None, ray_indices: Tensor, n_rays: int
    ) -> Tensor:
        shares = weights[:, None] if values is None else weights[:, None] * values
        return shares.new_zeros(n_rays, shares.shape[1]).index_add(0, ray_indices, shares)

    module = ModuleType("nerfacc")
    module.render_weight_from_alpha = render_weight_from_alpha  # type: ignore[attr-defined]
    module.accumulate_along_rays = accumulate_along_rays  # type: ignore[attr-defined]
    return module
