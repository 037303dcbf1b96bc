"""Hands and head in a body fit: which way palms and face look, and how far fingers are bent.

What is compared is a part's shape about its own middle, in the picture and, loosely, in depth: so a
part turns its joint and leaves where the joint is to the landmarks of the whole body. F frames, V
views, Q points of all parts.
"""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.body_estimation.body_landmarks import LandmarkMap
from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.body_estimation.part_landmarks import FACE_ROWS, WRISTS, PartLandmarks
from deblur_avatar.geometry.cameras import project

SPREAD = 0.005  # metres: of points on hands and faces about where they are expected
SHARE, DEPTH_SHARE = 0.008, 0.024  # standard deviations, of the person's height in the picture
FINEST = 1.0  # pixels: no detector is surer
SAME_HAND = 0.05  # of the height: a hand farther from the wrist is another one
SEEN = 0.35  # visibility of a wrist below which no hand is looked at
SATURATION = 3.0  # standard deviations at which a point has half its say

# MediaPipe's hand: (landmark, carrier, offset from the wrist in the rest pose, metres).
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


_HAND = len(HAND_ROWS)
GROUPS = (slice(0, _HAND), slice(_HAND, 2 * _HAND), slice(2 * _HAND, None))  # hands, face


class Parts(NamedTuple):
    """Points of the body that parts are compared at, and what was seen of them."""

    seen: Float[Tensor, "V F Q 3"]  # pixels; depth about the part's middle
    weights: Float[Tensor, "V F G"]  # of each part in each frame

    @property
    def hands_seen(self) -> bool:
        """Whether any hand was found in any frame."""
        return bool(self.weights[..., :2].any())

    def shares(self) -> dict[str, float]:
        """In how many of the views' frames each part was found."""
        found = (self.weights > 0).float().mean((0, 1)).tolist()
        return dict(zip(("left_hand", "right_hand", "face"), found, strict=True))


def part_map() -> LandmarkMap:
    """Where points of both hands and of the face are expected on a body."""
    carriers: list[int] = []
    anchors: list[int] = []
    shared: list[int] = []
    mirror, offsets = [], []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        wrist, hand = (SMPL_JOINT_NAMES.index(f"{side}_{name}") for name in ("wrist", "hand"))
        carriers += [wrist] * len(_PALM) + [hand] * len(_TIPS)
        anchors += [wrist] * len(_PALM) + [hand] * len(_TIPS)
        shared += range(len(HAND_ROWS))
        mirror += [[sign, 1.0, 1.0]] * len(HAND_ROWS)
    offsets += [offset for _, offset in (*_PALM, *_TIPS)]
    head = SMPL_JOINT_NAMES.index("head")
    carriers += [head] * len(FACE_ROWS)
    anchors += [head] * len(FACE_ROWS)
    shared += range(len(HAND_ROWS), len(HAND_ROWS) + len(FACE_ROWS))
    mirror += [[1.0, 1.0, 1.0]] * len(FACE_ROWS)
    offsets += _FACE
    return LandmarkMap(
        rows=tuple(range(len(carriers))),
        carriers=tuple(carriers),
        anchors=tuple(anchors),
        shared=tuple(shared),
        mirror=torch.tensor(mirror),
        offsets=torch.tensor(offsets),
        stds=torch.full((len(offsets),), SPREAD),
    )


PART_MAP = part_map()


def gather_parts(people: list[Landmarks], extent: float) -> Parts | None:
    """Give every hand that was found to the side it belongs to; None where none was looked for.

    Args:
        people: as the body is fitted to them, their mistakes taken out.
        extent: the person's height in the picture, pixels.
    """
    if all(person.parts is None for person in people):
        return None
    seen, weights = [], []
    for person in people:
        count = len(person.found)
        places, sure = torch.zeros(count, len(PART_MAP.rows), 3), torch.zeros(count, 3)
        if person.parts is not None:
            for side in (0, 1):
                hand = _hand_of(person, person.parts, side, extent)
                places[:, GROUPS[side]], sure[:, side] = hand
            places[:, GROUPS[2]] = person.parts.face
            sure[:, 2] = (person.parts.face_found & person.found).float()
        seen.append(places)
        weights.append(sure)
    return Parts(torch.stack(seen), torch.stack(weights))


def part_cost(
    parts: Parts,
    places: Float[Tensor, "F Q 3"],
    Ks: Float[Tensor, "V 3 3"],
    viewmats: Float[Tensor, "V 4 4"],
    extent: float,
    *,
    saturating: bool,
) -> Float[Tensor, ""]:
    """Squared distances of points about their part's middle, in standard deviations.

    Args:
        parts: what was seen.
        places: of the posed body's points, `PART_MAP`'s, metres.
        Ks: of each view.
        viewmats: world to camera.
        extent: the person's height in the picture, pixels.
        saturating: whether large distances lose their say; from the rest pose all are large.
    """
    flat, deep = max(SHARE * extent, FINEST), max(DEPTH_SHARE * extent, FINEST)
    sigma = places.new_tensor([flat, flat, deep])
    total = places.new_zeros(())
    for view, (K, viewmat) in enumerate(zip(Ks, viewmats, strict=True)):
        pixels, _ = project(places, K, viewmat)
        away = (places + viewmat[:3, :3].T @ viewmat[:3, 3]).norm(dim=-1)
        for index, rows in enumerate(GROUPS):
            weight = parts.weights[view, :, index]
            distance = away[:, rows].detach().mean(1, keepdim=True)
            deeper = K[0, 0] * away[:, rows] / distance  # in pixels of where the part is
            mine = torch.cat([pixels[:, rows], deeper[..., None]], dim=-1)
            theirs = parts.seen[view][:, rows]
            mine = mine - mine.mean(1, keepdim=True)
            theirs = theirs - theirs.mean(1, keepdim=True)
            gap = mine - theirs
            squared = (gap / sigma).square().sum(-1)
            if saturating:
                cost = squared / (1 + squared / SATURATION**2)
            else:
                cost = 2 * ((1 + squared).sqrt() - 1)
            total = total + (weight * cost.sum(1)).sum()
    return total


def _hand_of(
    person: Landmarks, parts: PartLandmarks, side: int, extent: float
) -> tuple[Float[Tensor, "F H 3"], Float[Tensor, " F"]]:
    """The hand nearest to a wrist that is of its side, and how sure it is."""
    wrist = person.points[:, WRISTS[side]]
    believed = person.found & (person.visibility[:, WRISTS[side]] >= SEEN)
    of_side = parts.left if side == 0 else 1 - parts.left
    distance = (parts.hands[:, :, 0, :2] - wrist[:, None]).norm(dim=-1)
    good = parts.hand_found & (of_side > 0.5) & (distance < SAME_HAND * extent)
    distance = torch.where(good, distance, torch.inf)
    slot = distance.argmin(1)
    frames = torch.arange(len(slot))
    sure = torch.where(good[frames, slot] & believed, of_side[frames, slot], 0.0)
    return parts.hands[frames, slot][:, list(HAND_ROWS)], sure
