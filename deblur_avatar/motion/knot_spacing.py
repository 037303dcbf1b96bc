"""How far apart the knots of a clip's trajectory stand: as far as the given poses allow.

Fewer knots share more frames and lie nearer to the truth than the poses they are fitted to, until
the body moves faster than they can follow. Which it is, poses that were kept back tell: a finer
trajectory must foretell them better, by more than given poses are wrong in such a rhythm.
"""

import logging

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.geometry.splines import fit_knots, spline_points
from deblur_avatar.motion.clip import continuous
from deblur_avatar.motion.trajectory import stacked_axis_angle

logger = logging.getLogger(__name__)

FOLDS = 4  # every n-th frame is kept back in turn
WORTH = 0.035  # radians by which the joint that gains most must be foretold better


def choose_spacing(
    poses: Poses,
    timestamps: Float[Tensor, " F"],
    coarsest: float,
    finest: float,
    smoothness: float,
) -> float:
    """Halve the spacing (seconds) from the coarsest on as long as that foretells poses better.

    Args:
        poses: given, one a frame, of two frames or more.
        timestamps: of the frames, seconds.
        coarsest: spacing that is kept unless another is worth it.
        finest: spacing below which it is not halved; as coarse as the coarsest: nothing is chosen.
        smoothness: of the fitted knots, as in `fit_knots`.
    """
    chosen, errors = coarsest, None
    spacing = coarsest / 2
    while spacing > finest * 0.999:
        errors = _misses(poses, timestamps, chosen, smoothness) if errors is None else errors
        finer = _misses(poses, timestamps, spacing, smoothness)
        gain = float((errors - finer).max())
        if gain > WORTH:
            logger.info(
                "knots every %.1f ms foretell poses %.1f degrees better", 1e3 * spacing,
                torch.rad2deg(torch.tensor(gain)),
            )  # fmt: skip
            chosen, errors = spacing, finer
        spacing /= 2
    return chosen


def _misses(
    poses: Poses, timestamps: Tensor, spacing: float, smoothness: float
) -> Float[Tensor, " J"]:
    """Root mean square angle by which each joint's kept-back rotations are missed, radians."""
    quats = continuous(axis_angle_to_quat(stacked_axis_angle(poses)))
    span = float(timestamps[-1] - timestamps[0])
    count = max(round(span / spacing) + 1, 2)
    times = (timestamps - timestamps[0]) * ((count - 1) / max(span, 1e-9))
    frames = torch.arange(len(timestamps))
    missed = []
    for fold in range(FOLDS):
        # The ends stay: nothing is foretold beyond the frames.
        back = (frames % FOLDS == fold) & (frames > 0) & (frames < len(frames) - 1)
        if not bool(back.any()):
            continue
        knots = fit_knots(quats[~back].flatten(1), times[~back], count, smoothness)
        foretold = spline_points(knots, times[back]).unflatten(1, quats.shape[1:])
        foretold = torch.nn.functional.normalize(foretold, dim=-1)
        apart = quat_multiply(quat_conjugate(foretold), quats[back])
        missed.append(quat_to_axis_angle(apart).norm(dim=-1))
    if not missed:
        return torch.zeros(quats.shape[1])
    return torch.cat(missed).square().mean(0).sqrt()
