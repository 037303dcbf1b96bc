"""Poses of frames in which nobody was seen.

A fit knows nothing of them but that poses are near rest and change smoothly: after a fifth of a
second somebody who ran out of the picture stands there with spread arms.
"""

from dataclasses import replace

from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.rotations import turn_between

EASE_S = 0.1  # from a frame that was seen: as long as a fit goes on moving as it did there


def between_seen(poses: Poses, seen: Bool[Tensor, " F"], timestamps: Float[Tensor, " F"]) -> Poses:
    """Put poses of unseen frames evenly between the last that was seen and the next (decision 76).

    Beside these they go over into the fit's, which moves on. Before the first and after the last
    nobody moves. Where nothing was seen poses are returned.

    Args:
        poses: a fit's, of all frames.
        seen: the frames whose pose rests on what was seen.
        timestamps: seconds.
    """
    if bool(seen.all()) or not bool(seen.any()):
        return poses
    here, there = timestamps[~seen], timestamps[seen]
    even = poses.at(seen.nonzero().flatten()).at_times(there, here)
    share = ((here[:, None] - there).abs().amin(1) / EASE_S).clamp(max=1)
    share = share.square() * (3 - 2 * share)
    turns, transl = poses.axis_angle, poses.transl.clone()
    turns[~seen] = turn_between(turns[~seen], even.axis_angle, share)
    transl[~seen] = transl[~seen].lerp(even.transl, share[:, None])
    return replace(poses, global_orient=turns[:, 0], body_pose=turns[:, 1:], transl=transl)
