"""Hands and head in a body fit: which way palms and face look, and how far fingers are bent.

What is compared is a part's shape about its own middle, in the picture and, loosely, in depth: so a
part turns its joint and leaves where the joint is to the landmarks of the whole body. F frames, V
views, Q points of all parts.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.body_estimation.body_landmarks import LandmarkMap
from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.body_estimation.part_landmarks import (
    FACE_NOSE,
    FACE_ROWS,
    NOSE,
    WRISTS,
    PartLandmarks,
)
from deblur_avatar.geometry.cameras import camera_centres, project

SPREAD = 0.005  # metres: of points on hands and faces about where they are expected
SHARE, DEPTH_SHARE = 0.008, 0.024  # standard deviations, of the person's size in the picture
FINEST = 1.0  # pixels: the least standard deviation
SAME_PART = 0.05  # of the size: a hand or a nose farther from the body's own is somebody else's
VISIBLE = 0.35  # visibility of a wrist or nose below which its part is not believed
BENDING = 0.05  # share of frames in which a hand must be found for its fingers to bend

# MediaPipe's hand: landmark, and where it is from the wrist in the left hand's rest pose, metres.
_PALM = (
    (0, (0.0, 0.0, 0.0)),
    (1, (0.040, 0.006, 0.025)),  # thumb's root
    (2, (0.052, -0.006, 0.052)),
    (5, (0.108, 0.007, 0.027)),  # roots of the fingers
    (9, (0.108, 0.0, 0.0)),
    (13, (0.101, -0.008, -0.019)),
    (17, (0.092, -0.020, -0.035)),
)
_TIPS = (  # from the hand's joint, the root of the middle finger
    (8, (0.070, -0.022, 0.048)),
    (12, (0.083, -0.039, 0.006)),
    (16, (0.068, -0.047, -0.026)),
    (20, (0.032, -0.053, -0.044)),
)
_FACE = (  # `FACE_ROWS` in their order: from the head's joint
    (0.0, 0.05, 0.145),
    (0.0, 0.09, 0.128),
    (0.05, 0.085, 0.108),
    (-0.05, 0.085, 0.108),
    (0.0, 0.16, 0.117),
    (0.075, 0.06, 0.055),
    (-0.075, 0.06, 0.055),
    (0.0, -0.035, 0.100),
)
HAND_ROWS = tuple(row for row, _ in (*_PALM, *_TIPS))
PARTS = ("left_hand", "right_hand", "face")
PART_LANDMARKS = (*WRISTS, NOSE)  # of the whole body, by which each part is known to be hers
_HAND = len(HAND_ROWS)
GROUPS = (slice(0, _HAND), slice(_HAND, 2 * _HAND), slice(2 * _HAND, None))  # hands, face


class Parts(NamedTuple):
    """What was seen of hands and face; points in the order of `PART_MAP`."""

    seen: Float[Tensor, "V F Q 3"]  # pixels; depth from where it may
    weights: Float[Tensor, "V F G"]  # of each part in each frame
    sizes: Float[Tensor, "V F"]  # of the person in the picture, pixels

    def shares(self) -> dict[str, float]:
        """In how many of the views' frames each part was found."""
        found = (self.weights > 0).float().mean((0, 1)).tolist()
        return dict(zip(PARTS, found, strict=True))

    def hands_seen(self) -> tuple[str, ...]:
        """Hands that were found often enough to tell how fingers bend."""
        return tuple(name for name in PARTS[:2] if self.shares()[name] >= BENDING)


def part_map() -> LandmarkMap:
    """Where points of both hands and of the face are expected on a body."""
    joints: list[int] = []
    shared: list[int] = []
    mirror: list[list[float]] = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        wrist, hand = (SMPL_JOINT_NAMES.index(f"{side}_{name}") for name in ("wrist", "hand"))
        joints += [wrist] * len(_PALM) + [hand] * len(_TIPS)
        shared += range(_HAND)
        mirror += [[sign, 1.0, 1.0]] * _HAND
    joints += [SMPL_JOINT_NAMES.index("head")] * len(_FACE)
    shared += range(_HAND, _HAND + len(_FACE))
    mirror += [[1.0, 1.0, 1.0]] * len(_FACE)
    offsets = [*(offset for _, offset in (*_PALM, *_TIPS)), *_FACE]
    return LandmarkMap(
        rows=tuple(range(len(joints))),
        carriers=tuple(joints),
        anchors=tuple(joints),
        shared=tuple(shared),
        mirror=torch.tensor(mirror),
        offsets=torch.tensor(offsets),
        stds=torch.full((len(offsets),), SPREAD),
    )


PART_MAP = part_map()


def gather_parts(people: list[Landmarks], agreed: Bool[Tensor, "V F G"]) -> Parts | None:
    """Give every part that was found to the body's own it belongs to.

    Args:
        people: as the body is fitted to them.
        agreed: views and frames whose `PART_LANDMARKS` other views do not gainsay.

    Returns:
        None where parts were looked for in no view.
    """
    if all(person.parts is None for person in people):
        return None
    seen, weights, sizes = [], [], []
    for person in people:
        count = len(person.found)
        places, sure = torch.zeros(count, len(PART_MAP.rows), 3), torch.zeros(count, len(GROUPS))
        size = torch.ones(count)
        if person.parts is not None:
            size = person.parts.sizes
            for index in range(len(GROUPS)):
                find = _face_of if index == PARTS.index("face") else _hand_of
                part, certain = find(person, person.parts, index)
                near = part.distance < SAME_PART * size
                visible = person.visibility[:, PART_LANDMARKS[index]] >= VISIBLE
                places[:, GROUPS[index]] = part.points
                sure[:, index] = certain * (near & visible & person.found)
        seen.append(places)
        weights.append(sure)
        sizes.append(size)
    return Parts(torch.stack(seen), torch.stack(weights) * agreed, torch.stack(sizes))


def part_cost(
    parts: Parts,
    places: Float[Tensor, "F Q 3"],
    Ks: Float[Tensor, "V 3 3"],
    viewmats: Float[Tensor, "V 4 4"],
    robust: Callable[[Tensor], Tensor],
) -> Float[Tensor, ""]:
    """Squared distances of points about their part's middle, in standard deviations.

    Args:
        parts: what was seen.
        places: of the posed body's points, `PART_MAP`'s, metres.
        Ks: of each view.
        viewmats: world to camera.
        robust: what a squared distance costs.
    """
    total = places.new_zeros(())
    for view, (K, viewmat) in enumerate(zip(Ks, viewmats, strict=True)):
        flat, deep = (
            (share * parts.sizes[view]).clamp(min=FINEST) for share in (SHARE, DEPTH_SHARE)
        )
        sigma = torch.stack([flat, flat, deep], dim=-1)[:, None]
        pixels, _ = project(places, K, viewmat)
        away = (places - camera_centres(viewmat)).norm(dim=-1)
        for index, rows in enumerate(GROUPS):
            distance = away[:, rows].detach().mean(1, keepdim=True)
            deeper = K[0, 0] * away[:, rows] / distance  # in pixels of where the part is
            mine = torch.cat([pixels[:, rows], deeper[..., None]], dim=-1)
            theirs = parts.seen[view][:, rows]
            gap = (mine - mine.mean(1, keepdim=True)) - (theirs - theirs.mean(1, keepdim=True))
            cost = robust((gap / sigma).square().sum(-1))
            total = total + (parts.weights[view, :, index] * cost.sum(1)).sum()
    return total


class _Found(NamedTuple):
    """One part in F frames, and how far it is from where the body has it."""

    points: Float[Tensor, "F N 3"]
    distance: Float[Tensor, " F"]  # pixels


def _hand_of(
    person: Landmarks, parts: PartLandmarks, side: int
) -> tuple[_Found, Float[Tensor, " F"]]:
    """The hand of a side that is nearest to its wrist, and how sure its side is."""
    of_side = parts.left if side == 0 else 1 - parts.left
    wrist = person.points[:, None, WRISTS[side]]
    distance = (parts.hands[:, :, 0, :2] - wrist).norm(dim=-1)
    distance = torch.where(parts.hand_found & (of_side > 0.5), distance, torch.inf)
    frames, slot = torch.arange(len(distance)), distance.argmin(1)
    hand = parts.hands[frames, slot][:, list(HAND_ROWS)]
    return _Found(hand, distance[frames, slot]), of_side[frames, slot]


def _face_of(
    person: Landmarks, parts: PartLandmarks, index: int
) -> tuple[_Found, Float[Tensor, " F"]]:
    """The face, known by its nose."""
    nose = parts.face[:, FACE_ROWS.index(FACE_NOSE), :2]
    distance = (nose - person.points[:, PART_LANDMARKS[index]]).norm(dim=-1)
    return _Found(parts.face, distance), parts.face_found.float()
