"""Capsules of limbs, trunk and hair: where landmarks say that there is nothing but them.

A background can have the colour of trousers, and where both meet a picture does not tell them
apart. Landmarks do: along the line from a hip to a knee there is a thigh. Each limb is a tapered
capsule about that line, no wider than it, when the shutter opens, in the middle and when it shuts:
what all three cover shows the limb alone, however it is blurred, and so its own colour.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.body_estimation.part_landmarks import marked_sizes
from deblur_avatar.body_estimation.same_person import HIPS, SHOULDERS, SURE

EARS = (7, 8)  # MediaPipe's landmarks


class _End(NamedTuple):
    marks: tuple[int, ...]  # MediaPipe's landmarks, in whose middle it is
    radius: float  # as a share of a person's size
    beyond: float = 0.0  # the end is as much farther from between the shoulders than these


_LEFT = (  # the right side's landmarks have the next numbers
    (_End((23,), 0.038), _End((25,), 0.027)),  # thigh
    (_End((25,), 0.027), _End((27,), 0.018)),  # shin
    (_End((27,), 0.015), _End((29,), 0.012)),  # heel
    (_End((29,), 0.012), _End((31,), 0.010)),  # sole
    (_End((11,), 0.022), _End((13,), 0.016)),  # upper arm
    (_End((13,), 0.016), _End((15,), 0.012)),  # forearm
)
_TRUNK = (_End(tuple(SHOULDERS), 0.045), _End(tuple(HIPS), 0.045))
_HAIR = (_End(EARS, 0.025, beyond=0.2), _End(EARS, 0.02, beyond=0.4))  # no landmark is above ears
_LIMBS = (
    *_LEFT,
    *(tuple(end._replace(marks=(end.marks[0] + 1,)) for end in limb) for limb in _LEFT),
    _TRUNK,
    _HAIR,
)


def limb_capsules(person: Landmarks) -> Float[Tensor, "F B 3 6"]:
    """Tapered capsules of limbs when the shutter opens, in the middle, and when it shuts.

    It may be open from halfway to the frame before to halfway to the next one. Capsules are two
    ends, each with its radius: right, down, radius, pixels; NaN where an end is not sure.
    """
    sure = person.found[:, None] & (person.visibility >= SURE)
    points = torch.where(sure[..., None], person.points, torch.nan)
    beyond = torch.full_like(points[:1], torch.nan)
    before, after = torch.cat([beyond, points[:-1]]), torch.cat([points[1:], beyond])
    instants = torch.stack([points.lerp(before, 0.5), points, points.lerp(after, 0.5)], dim=2)
    sizes = marked_sizes(person.points.numpy(), person.visibility.numpy() > 0)
    size = torch.from_numpy(sizes).float()[:, None].expand(-1, 3)
    shoulders = instants[:, SHOULDERS].mean(1)

    def placed(end: _End) -> Float[Tensor, "F 3 3"]:
        middle = instants[:, list(end.marks)].mean(1)
        if end.beyond:
            middle = shoulders.lerp(middle, 1 + end.beyond)
        return torch.cat([middle, (end.radius * size)[..., None]], dim=-1)

    return torch.stack([torch.cat([*map(placed, limb)], dim=-1) for limb in _LIMBS], dim=1)
