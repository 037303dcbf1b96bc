"""The terms of the objective, each a number that is 0 when nothing is wrong.

Conventions. Images are sRGB in [0, 1]; means run over all pixels and channels, so weights do not
depend on the resolution.
"""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from deblur_avatar.imaging.metrics import ssim


def photometric(
    image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"]
) -> Float[Tensor, ""]:
    """Mean absolute difference."""
    return (image - target).abs().mean()


def structure(
    image: Float[Tensor, "H W 3"],
    target: Float[Tensor, "H W 3"],
    box: tuple[int, int, int, int],
) -> Float[Tensor, ""]:
    """1 - SSIM inside a box (left, top, right, bottom; pixels): the weight-free stand-in for LPIPS.

    Source: Kerbl et al. 2023 (the structural term of 3D Gaussian splatting); the paper has LPIPS on
    the mask's box in its place, whose network's weights cannot be shipped.
    """
    left, top, right, bottom = box
    inside = image[None, top:bottom, left:right], target[None, top:bottom, left:right]
    return 1 - ssim(*inside)[0].float()


def coverage(alpha: Float[Tensor, "H W"], matte: Float[Tensor, "H W"]) -> Float[Tensor, ""]:
    """Mean absolute difference of coverage."""
    return (alpha - matte).abs().mean()


def skinning(
    weights: Float[Tensor, "P J"], body_weights: Float[Tensor, "P J"]
) -> Float[Tensor, ""]:
    """Squared distance of learned blend weights from the body's own, on the body's surface.

    Source: 3DGS-Avatar, L_skin.
    """
    return (weights - body_weights).square().sum(1).mean()


def isotropy_of_means(
    canonical: Float[Tensor, "N 3"],
    posed: Float[Tensor, "N 3"],
    neighbours: Int64[Tensor, "N K"],
) -> Float[Tensor, ""]:
    """Neighbours keep their distances when the body moves, metres.

    Source: 3DGS-Avatar, L_isopos, after Prokudin et al., "as isometric as possible".
    """
    return (_spacings(canonical, neighbours) - _spacings(posed, neighbours)).abs().mean()


def isotropy_of_covars(
    canonical: Float[Tensor, "N 6"],
    posed: Float[Tensor, "N 6"],
    neighbours: Int64[Tensor, "N K"],
) -> Float[Tensor, ""]:
    """Neighbours keep the differences of their covariances, square metres.

    Source: 3DGS-Avatar, L_isocov. Like there, off-diagonal entries count once, so the term is not
    quite invariant under rotation.
    """
    return (_spacings(canonical, neighbours) - _spacings(posed, neighbours)).abs().mean()


def _spacings(values: Tensor, neighbours: Tensor) -> Tensor:
    # Not `norm`: two Gaussians in one place are the case where its gradient is not a number.
    apart = values[neighbours] - values[:, None]
    squared = apart.square().sum(-1)
    touching = squared < torch.finfo(values.dtype).tiny
    return torch.where(touching, torch.ones_like(squared), squared).sqrt() * ~touching
