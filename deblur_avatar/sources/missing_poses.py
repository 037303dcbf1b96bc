"""Interpolation of missing poses from the frames around them.

An estimator that loses the person leaves gaps. A body does not go far in a short one, and the
trajectory that is fitted later moves every pose anyway.
"""

import logging

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.pose_interpolation import interpolated

logger = logging.getLogger(__name__)

LONGEST = 15  # frames in a row without a pose: half a second at 30 a second
MAX_COUNT = 0.5  # of the frames


def without_pose(turns: Float[Tensor, "F J 3"], transl: Float[Tensor, "F 3"]) -> Bool[Tensor, " F"]:
    """Which frames have no pose: not one number of it. One that is NaN among others is an error."""
    return turns.isnan().flatten(1).all(1) & transl.isnan().all(1)


def fill_missing(
    turns: Float[Tensor, "F J 3"], transl: Float[Tensor, "F 3"], where: str
) -> tuple[Float[Tensor, "F J 3"], Float[Tensor, "F 3"]]:
    """Give frames without a pose one between those before and after, on the shortest arcs.

    Args:
        turns: all joints' rotations relative to their parents, axis-angle.
        transl: translations.
        where: what poses they are, for messages.

    Raises:
        ArtifactError: if the first or last frame has no pose, more than `MAX_COUNT` of the frames,
        or more than `LONGEST` in a row.
    """
    missing = without_pose(turns, transl)
    if not bool(missing.any()):
        return turns, transl
    count, frames = int(missing.sum()), len(missing)
    there = torch.nonzero(~missing).flatten()
    longest = int(there.diff().max()) - 1 if len(there) > 1 else frames
    advice = "choose frames that have poses, or set preprocess.poses to estimated"
    lost = f"{where}: {count} of {frames} frames have no pose"
    if bool(missing[0]) or bool(missing[-1]):
        raise ArtifactError(f"{lost}, the first or the last among them; {advice}")
    if count > MAX_COUNT * frames or longest > LONGEST:
        raise ArtifactError(
            f"{lost}, up to {longest} in a row; at most half of them and {LONGEST} in a row are "
            f"filled from those around them; {advice}"
        )
    logger.warning("%s, up to %d in a row; they are filled from those around", lost, longest)
    turns, transl, times = turns.clone(), transl.clone(), torch.arange(frames).to(transl)
    turns[missing], transl[missing] = interpolated(
        turns[~missing], transl[~missing], times[~missing], times[missing]
    )
    return turns, transl
