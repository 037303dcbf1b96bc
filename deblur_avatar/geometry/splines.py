"""B-splines: smooth curves of vectors and of rotations through time, uniform and cubic.

Conventions. K knots stand at times 0, 1, ..., K - 1 in units of their spacing. A curve is defined
from the first knot to the last; its ends are extended by repeating the outermost knots. Four knots
shape it at any time, so moving one moves only what is near. M evaluation times.
"""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
)


def basis(
    times: Float[Tensor, " M"], count: int
) -> tuple[Int64[Tensor, "M 4"], Float[Tensor, "M 4"]]:
    """Which knots shape the curve at each time, and their weights, which sum to 1."""
    times = times.clamp(0, count - 1)
    segment = times.floor().clamp(max=max(count - 2, 0))
    u = (times - segment)[:, None]
    indices = (segment.long()[:, None] + torch.arange(-1, 3, device=times.device)).clamp(
        0, count - 1
    )
    weights = torch.cat(
        [(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3], dim=1
    )
    return indices, weights / 6


def spline_points(
    knots: Float[Tensor, " K *shape"], times: Float[Tensor, " M"]
) -> Float[Tensor, " M *shape"]:
    """Evaluate a spline of vectors."""
    indices, weights = basis(times, len(knots))
    weights = weights.reshape(*weights.shape, *[1] * (knots.ndim - 1))
    return (weights * knots[indices]).sum(1)


def spline_quats(
    knots: Float[Tensor, "K *shape 4"], times: Float[Tensor, " M"]
) -> Float[Tensor, "M *shape 4"]:
    """Evaluate a spline of rotations given as unit quaternions.

    Source: the cumulative form of Kim, Kim and Shin, "A general construction scheme for unit
    quaternion curves with simple high order derivatives", SIGGRAPH 1995.
    """
    indices, weights = basis(times, len(knots))
    near = knots[indices]  # M 4 ... 4
    cumulative = weights.flip(1).cumsum(1).flip(1)[:, 1:]
    cumulative = cumulative.reshape(*cumulative.shape, *[1] * (knots.ndim - 1))
    steps = quat_to_axis_angle(quat_multiply(quat_conjugate(near[:, :-1]), near[:, 1:]))
    turns = axis_angle_to_quat(cumulative * steps)
    first = quat_multiply(near[:, 0], turns[:, 0])
    return quat_multiply(quat_multiply(first, turns[:, 1]), turns[:, 2])


def fit_knots(
    values: Float[Tensor, "M D"], times: Float[Tensor, " M"], count: int, smoothness: float
) -> Float[Tensor, "K D"]:
    """Knots of the spline of vectors nearest to values, as smooth as asked for.

    Args:
        values: what the curve should pass near.
        times: when, in units of the knots' spacing.
        count: how many knots.
        smoothness: weight of the squared second differences of the knots against the squared
            misses of the values; 0 trusts the values wherever they determine the knots.

    Source: Eilers and Marx, "Flexible smoothing with B-splines and penalties", 1996.
    """
    indices, weights = basis(times.double(), count)
    design = torch.zeros(len(times), count, dtype=torch.float64)
    design.scatter_add_(1, indices, weights)
    bend = torch.eye(count, dtype=torch.float64).diff(n=2, dim=0) if count > 2 else design[:0]
    # A trace of stiffness keeps knots that no value reaches on the line through their neighbours.
    normal = design.T @ design + (smoothness + 1e-6) * bend.T @ bend
    normal += 1e-9 * torch.eye(count, dtype=torch.float64)
    return torch.linalg.solve(normal, design.T @ values.double()).to(values.dtype)
