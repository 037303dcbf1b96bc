"""Knot spacing of a clip's trajectory, chosen by cross-validation on the given poses.

Fewer knots share more frames and lie nearer to the truth than the poses they are fitted to, until
the body moves faster than they can follow. So some poses are held back in turn: a finer spacing is
taken only if its trajectory predicts them better, for some joint, by more than the error that the
given poses may have themselves.
"""

import logging

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    continuous,
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.geometry.splines import fit_knots, spline_points

logger = logging.getLogger(__name__)

FOLDS = 4  # every n-th frame is held back in turn; not a parameter: any few do


def choose_spacing(
    poses: Poses,
    timestamps: Float[Tensor, " F"],
    seen: Bool[Tensor, " F"],
    coarsest: float,
    finest: float,
    smoothness: float,
    min_gain: float,
) -> float:
    """Halve the spacing (seconds) from the coarsest on as long as that predicts poses better.

    Args:
        poses: given, one a frame, of two frames or more.
        timestamps: of the frames, seconds.
        seen: the frames whose poses are worth predicting.
        coarsest: spacing that is kept unless another is worth it.
        finest: spacing below which it is not halved; as coarse as the coarsest: nothing is chosen.
        smoothness: of the fitted knots, as in `fit_knots`.
        min_gain: radians by which the joint that gains most must be predicted better.
    """
    chosen, errors = coarsest, None
    spacing = coarsest / 2
    while spacing > finest * 0.999:
        if errors is None:
            errors = _prediction_errors(poses, timestamps, seen, chosen, smoothness)
        finer = _prediction_errors(poses, timestamps, seen, spacing, smoothness)
        gain = float((errors - finer).max())
        if gain > min_gain:
            logger.info(
                "knots every %.1f ms predict poses %.1f degrees better", 1e3 * spacing,
                torch.rad2deg(torch.tensor(gain)),
            )  # fmt: skip
            chosen, errors = spacing, finer
        spacing /= 2
    return chosen


def _prediction_errors(
    poses: Poses,
    timestamps: Float[Tensor, " F"],
    seen: Bool[Tensor, " F"],
    spacing: float,
    smoothness: float,
) -> Float[Tensor, " J"]:
    """Root mean square angle by which each joint's held-back rotations are missed, radians."""
    quats = continuous(axis_angle_to_quat(poses.axis_angle))
    span = float(timestamps[-1] - timestamps[0])
    count = max(round(span / spacing) + 1, 2)
    times = (timestamps - timestamps[0]) * ((count - 1) / max(span, 1e-9))
    frames = torch.arange(len(timestamps))
    errors = []
    for fold in range(FOLDS):
        # The ends stay: nothing is predicted beyond the frames.
        held_back = (frames % FOLDS == fold) & (frames > 0) & (frames < len(frames) - 1)
        missed = held_back & seen
        if not bool(missed.any()):
            continue
        knots = fit_knots(quats[~held_back].flatten(1), times[~held_back], count, smoothness)
        predicted = spline_points(knots, times[missed]).unflatten(1, quats.shape[1:])
        predicted = torch.nn.functional.normalize(predicted, dim=-1)
        apart = quat_multiply(quat_conjugate(predicted), quats[missed])
        errors.append(quat_to_axis_angle(apart).norm(dim=-1))
    if not errors:
        return torch.zeros(quats.shape[1])
    return torch.cat(errors).square().mean(0).sqrt()
