"""Poses at other times than those that are known."""

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.geometry.rotations import turn_between


def interpolated(
    turns: Float[Tensor, "F J 3"],
    transl: Float[Tensor, "F 3"],
    known: Float[Tensor, " F"],
    wanted: Float[Tensor, " S"],
) -> tuple[Float[Tensor, "S J 3"], Float[Tensor, "S 3"]]:
    """Rotations on the shortest arcs at constant speed, places on straight lines.

    Before the first known time and after the last one nobody moves.

    Args:
        turns: all joints' rotations relative to their parents, axis-angle.
        transl: translations, metres.
        known: their times, which increase.
        wanted: times of the poses wanted.
    """
    after = torch.searchsorted(known, wanted).clamp(1, max(len(known) - 1, 1))
    before, after = after - 1, after.clamp(max=len(known) - 1)
    gap = (known[after] - known[before]).clamp(min=1e-9)
    share = ((wanted - known[before]) / gap).clamp(0, 1).to(transl)
    turned = turn_between(turns[before], turns[after], share)
    return turned, torch.lerp(transl[before], transl[after], share[:, None])
