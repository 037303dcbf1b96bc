"""Pose noise: correlated errors of the poses that fitting starts from."""

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.sources.studio.motion import Moves


def correlated_noise(
    timestamps: Float[Tensor, " F"],
    correlation_s: float,
    channels: int,
    generator: torch.Generator,
) -> Float[Tensor, "F channels"]:
    """Draw Gaussian noise of variance 1 with correlation exp(-lag / correlation_s) over time.

    That is an Ornstein-Uhlenbeck process: it drifts slowly and jitters from frame to frame, as pose
    estimators do. A correlation time of 0 leaves independent frames.
    """
    lag = (timestamps[:, None] - timestamps[None]).abs().double()
    correlation = torch.exp(-lag / max(correlation_s, 1e-9))
    white = torch.randn(len(timestamps), channels, generator=generator, dtype=torch.float64)
    return torch.linalg.cholesky(correlation) @ white.to(lag.device)


def disturb(
    moves: Moves,
    timestamps: Float[Tensor, " F"],
    degrees: float,
    millimetres: float,
    correlation_s: float,
    generator: torch.Generator,
) -> Moves:
    """Turn every joint, the pelvis included, and shift the root by noise correlated in time.

    Args:
        moves: the true poses.
        timestamps: seconds.
        degrees: root mean square of each joint's angle of error; it is turned in its parent's frame
            after its true rotation, about an axis without preference.
        millimetres: root mean square of the root's distance from its place.
        correlation_s: seconds; see `correlated_noise`.
        generator: the source of the noise.
    """
    count = 1 + moves.body_pose.shape[1]
    noise = correlated_noise(timestamps, correlation_s, 3 * count + 3, generator) / 3**0.5
    turns = (noise[:, : 3 * count] * degrees * torch.pi / 180).unflatten(1, (count, 3))
    true = moves.axis_angle
    quats = quat_multiply(axis_angle_to_quat(turns), axis_angle_to_quat(true))
    wrong = quat_to_axis_angle(quats) if degrees > 0 else true
    shift = noise[:, 3 * count :] * millimetres / 1000
    return Moves(wrong[:, 0], wrong[:, 1:], moves.transl + shift)
