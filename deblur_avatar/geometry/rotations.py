"""Rotations of three-dimensional space in three spellings.

Conventions. Quaternions are `wxyz` and of unit length; `q` and `-q` are the same rotation.
Axis-angle vectors are in radians, their length is the angle. Matrices act on column vectors.
Every function is differentiable everywhere it is defined, the identity included.
"""

from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

SMALL_ANGLE = 1e-4  # radians; below it the Taylor series is exact in float64 to 1e-17


# Rotation matrices and Hamilton's product are sums of products of two quaternions' entries. Written
# as one product with a table they are two calls instead of forty, and their gradients too: a
# fitting step turns many short lists of quaternions. Each string is one entry of the result.
_MATRIX = (
    "ww+xx-yy-zz", "xy+xy-wz-wz", "xz+xz+wy+wy",
    "xy+xy+wz+wz", "ww-xx+yy-zz", "yz+yz-wx-wx",
    "xz+xz-wy-wy", "yz+yz+wx+wx", "ww-xx-yy+zz",
)  # fmt: skip
_PRODUCT = ("ww-xx-yy-zz", "wx+xw+yz-zy", "wy-xz+yw+zx", "wz+xy-yx+zw")


def axis_angle_to_quat(axis_angle: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 4"]:
    """Turn axis-angle vectors into unit quaternions, real part first, for angles <= pi positive."""
    squared = axis_angle.square().sum(-1, keepdim=True)
    small = squared < SMALL_ANGLE**2
    angle = torch.where(small, torch.ones_like(squared), squared).sqrt()
    real = torch.where(small, 1 - squared / 8, (angle / 2).cos())
    factor = torch.where(small, 0.5 - squared / 48, (angle / 2).sin() / angle)
    return torch.cat([real, factor * axis_angle], dim=-1)


def quat_to_axis_angle(quats: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3"]:
    """Turn unit quaternions into axis-angle vectors of angle at most pi."""
    quats = torch.where(quats[..., :1] < 0, -quats, quats)
    real, imaginary = quats[..., :1], quats[..., 1:]
    squared = imaginary.square().sum(-1, keepdim=True)
    small = squared < SMALL_ANGLE**2
    length = torch.where(small, torch.ones_like(squared), squared).sqrt()
    # 2 atan(s / c) / s, whose series at s = 0 is 2 / c - 2 s^2 / (3 c^3), with c = 1 - s^2 / 2.
    factor = torch.where(small, 2 + squared / 3, 2 * torch.atan2(length, real) / length)
    return factor * imaginary


def quat_to_matrix(quats: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Turn quaternions into rotation matrices; quaternions are normalised first."""
    squared = quats.square().sum(-1, keepdim=True) + torch.finfo(quats.dtype).tiny
    rows = _products(quats, quats) @ _table(_MATRIX, quats)
    return (rows / squared).unflatten(-1, (3, 3))


def matrix_to_quat(matrices: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 4"]:
    """Turn rotation matrices into unit quaternions with non-negative real part.

    Of the four ways to divide, the one with the largest divisor is taken, so that the result is
    accurate near half turns too.
    """
    m = matrices.flatten(-2)
    xx, xy, xz, yx, yy, yz, zx, zy, zz = m.unbind(-1)
    candidates = torch.stack(
        [
            torch.stack([1 + xx + yy + zz, zy - yz, xz - zx, yx - xy], -1),
            torch.stack([zy - yz, 1 + xx - yy - zz, yx + xy, xz + zx], -1),
            torch.stack([xz - zx, yx + xy, 1 - xx + yy - zz, zy + yz], -1),
            torch.stack([yx - xy, xz + zx, zy + yz, 1 - xx - yy + zz], -1),
        ],
        -2,
    )
    best = candidates.diagonal(dim1=-2, dim2=-1).argmax(-1)
    index = best[..., None, None].expand(*best.shape, 1, 4)
    quats = torch.nn.functional.normalize(candidates.gather(-2, index).squeeze(-2), dim=-1)
    return torch.where(quats[..., :1] < 0, -quats, quats)


def axis_angle_to_matrix(axis_angle: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Turn axis-angle vectors into rotation matrices."""
    return quat_to_matrix(axis_angle_to_quat(axis_angle))


def matrix_to_axis_angle(matrices: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3"]:
    """Turn rotation matrices into axis-angle vectors of angle at most pi."""
    return quat_to_axis_angle(matrix_to_quat(matrices))


def quat_multiply(
    a: Float[Tensor, "*batch 4"], b: Float[Tensor, "*batch 4"]
) -> Float[Tensor, "*batch 4"]:
    """Compose rotations: first `b`, then `a` (Hamilton's product)."""
    return _products(a, b) @ _table(_PRODUCT, a)


def quat_conjugate(quats: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Invert rotations given as unit quaternions."""
    return quats * quats.new_tensor([1.0, -1.0, -1.0, -1.0])


def slerp(
    start: Float[Tensor, "*batch 4"], end: Float[Tensor, "*batch 4"], u: Float[Tensor, " S"]
) -> Float[Tensor, "S *batch 4"]:
    """Turn from `start` (u = 0) to `end` (u = 1) along the shorter arc at constant speed.

    Source: Deblur-Avatar (arXiv 2501.13335) eq. 6 with its two weights put the right way round
    and the double cover of rotations by quaternions resolved. Written as start * (start^-1 end)^u,
    which has finite, exact gradients where both ends are equal, where the usual form divides 0 / 0.
    """
    return _partway(start, end, u.reshape(-1, *[1] * start.ndim))


def turn_between(
    start: Float[Tensor, "F *joints 3"],
    end: Float[Tensor, "F *joints 3"],
    share: Float[Tensor, " F"],
) -> Float[Tensor, "F *joints 3"]:
    """Turn along the shorter arc, with a share of its own for each frame; axis-angle in and out."""
    first, last = axis_angle_to_quat(start), axis_angle_to_quat(end)
    return quat_to_axis_angle(_partway(first, last, share.reshape(-1, *[1] * (first.ndim - 1))))


def _partway(
    start: Float[Tensor, "*batch 4"], end: Float[Tensor, "*batch 4"], share: Float[Tensor, "..."]
) -> Float[Tensor, "... 4"]:
    """Turn by shares of the way that broadcast against axis-angle vectors of the whole of it."""
    step = quat_to_axis_angle(quat_multiply(quat_conjugate(start), end))
    parts = axis_angle_to_quat(share * step)
    return quat_multiply(start.expand_as(parts), parts)


def _products(a: Float[Tensor, "*batch 4"], b: Float[Tensor, "*batch 4"]) -> Tensor:
    """All products of an entry of `a` with an entry of `b`, 16 a pair."""
    return (a[..., :, None] * b[..., None, :]).flatten(-2)


def _table(sums: tuple[str, ...], like: Tensor) -> Tensor:
    return _signs(sums, like.dtype, like.device)


@cache
def _signs(sums: tuple[str, ...], dtype: torch.dtype, device: torch.device) -> Tensor:
    """Which products each sum adds and takes away, one column a sum."""
    table = torch.zeros(16, len(sums), dtype=dtype)
    for column, terms in enumerate(sums):
        for start in range(0, len(terms), 3):
            first, second = ("wxyz".index(letter) for letter in terms[start : start + 2])
            sign = -1 if start and terms[start - 1] == "-" else 1
            table[4 * first + second, column] += sign
    return table.to(device)


def continuous(quats: Float[Tensor, "F J 4"]) -> Float[Tensor, "F J 4"]:
    """Choose, of the two quaternions of each rotation, the one nearer to the frame before."""
    flips = torch.where((quats[1:] * quats[:-1]).sum(-1) < 0, -1.0, 1.0)
    signs = torch.cat([torch.ones_like(flips[:1]), flips]).cumprod(0)
    return quats * signs[..., None]
