"""Covariance matrices of Gaussians, whole or as their upper triangles.

The six are the upper triangle in reading order: xx, xy, xz, yy, yz, zz.
"""

from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

# Where in the six numbers each entry of the 3x3 matrix is found, in reading order.
_ENTRIES = (0, 1, 2, 1, 3, 4, 2, 4, 5)
_UPPER = (0, 1, 2, 4, 5, 8)  # and where in the matrix each of the six


def covariances(
    quats: Float[Tensor, "N 4"], scales: Float[Tensor, "N 3"]
) -> Float[Tensor, "N 3 3"]:
    """Build covariance matrices from rotations and standard deviations.

    Args:
        quats: rotations as wxyz quaternions of any length but zero.
        scales: standard deviations along the rotated axes, metres.

    Returns:
        `R diag(scales)^2 R^T`, square metres.
    """
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rotations = torch.stack(
        [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ],
        dim=-1,
    ).unflatten(-1, (3, 3))
    axes = rotations * scales[..., None, :]
    return axes @ axes.mT


def whole_matrices(
    covars: Float[Tensor, "*batch N 6"] | Float[Tensor, "*batch N 3 3"],
) -> Float[Tensor, "*batch N 3 3"]:
    """Write six numbers out as a symmetric matrix; whole matrices pass through."""
    if covars.shape[-1] == 3:
        return covars
    picked = covars @ _picking(_ENTRIES, 6, covars.dtype, covars.device)
    return picked.unflatten(-1, (3, 3))


def upper_triangles(covars: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 6"]:
    """Keep the six numbers that determine a symmetric matrix."""
    return covars.flatten(-2) @ _picking(_UPPER, 9, covars.dtype, covars.device)


@cache
def _picking(
    entries: tuple[int, ...], count: int, dtype: torch.dtype, device: torch.device
) -> Float[Tensor, "count E"]:
    """Ones that pick entries: an index's gradient takes a GPU much longer than a product's."""
    return torch.eye(count, dtype=dtype, device=device)[:, list(entries)]
