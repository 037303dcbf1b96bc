"""Landmark tracking: outliers that a detector produces under blur are taken out.

Three mistakes are looked for: left and right exchanged for some frames (arms and legs apart),
jumps to a wrong place and back, and losses, where a landmark is hardly seen. Exchanged ones are
put right. Jumps and losses are flagged, filled in from their neighbours for what needs a value in
every frame, and given little or no confidence. What is lost beyond the picture's edge may keep the
detector's guess: legs of who is filmed from the waist up were seen long ago, or by mistake. F
frames, L MediaPipe's 33 landmarks; lengths in shares of the person's size in the picture, speeds in
sizes a second.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from deblur_avatar.body_estimation.landmarks import COUNT, Landmarks
from deblur_avatar.body_estimation.pace import Pace

MIRRORED = (0, 4, 5, 6, 1, 2, 3, *(mark + (1 if mark % 2 else -1) for mark in range(7, COUNT)))
ARMS, LEGS = tuple(range(11, 23)), tuple(range(23, 33))
LOST = 0.35  # visibility below which a landmark counts as lost
SWAP_COST = 0.02  # a frame: exchanging sides must win more than this in smoothness
FAST = 3.5  # sizes a second: faster, and a detection is suspect
JUMP_COST = 0.15  # what leaving out one detection costs, in excess sizes
GAP = 10  # frame intervals that a landmark may be gone before its track starts anew


class Flags(NamedTuple):
    """What was found wrong, by frame and landmark."""

    swapped: Bool[Tensor, "F L"]
    jumped: Bool[Tensor, "F L"]
    lost: Bool[Tensor, "F L"]

    def counts(self) -> dict[str, int]:
        """How many detections of each kind."""
        return {name: int(flags.sum()) for name, flags in self._asdict().items()}


@dataclass(frozen=True)
class CleanTrack:
    """A person with flagged landmarks filled in and at no confidence."""

    person: Landmarks
    flags: Flags


def sizes(points: Float[Tensor, "F L 2"], *, any_pose: bool) -> Float[Tensor, " F"]:
    """A person's size in each frame: the height of the box around points of hers.

    Args:
        points: landmarks or joints, right and down: pixels, or metres across the view.
        any_pose: she may lie: the longer side of the box.
    """
    sides = points.amax(1) - points.amin(1)
    return sides.amax(1) if any_pose else sides[:, 1]


def size_in_pictures(people: Sequence[Landmarks], *, any_pose: bool) -> float:
    """A person's median size over all frames of all views, pixels; 1 where nobody was found.

    Args:
        people: one person, view by view.
        any_pose: as in `sizes`.
    """
    found = torch.cat([sizes(one.points[one.found], any_pose=any_pose) for one in people])
    return float(found.median().clamp(min=1.0)) if len(found) else 1.0


def clean(person: Landmarks, pace: Pace, size: float, *, any_pose: bool) -> CleanTrack:
    """Put right and flag the landmarks of a clip.

    Args:
        person: as detected, no smoothing over time.
        pace: of the frames.
        size: of the person in the picture, pixels.
        any_pose: what is lost beyond the picture's edge stays where the detector guesses it.
    """
    points = person.points.numpy().astype(np.float64) / size
    visibility = person.visibility.numpy() * person.found.numpy()[:, None]
    swapped = np.zeros(visibility.shape, bool)
    for group in (ARMS, LEGS):
        swapped[:, list(group)] = _swapped_frames(points, visibility, group)[:, None]
    points = _exchanged(points, swapped)
    visibility = _exchanged(visibility[..., None], swapped)[..., 0]
    lost = visibility < LOST
    places = pace.places.numpy()
    jumped = np.zeros_like(lost)
    for mark in range(COUNT):
        jumped[:, mark] = _jumps(points[:, mark], ~lost[:, mark], pace)
    guessed = lost & _beyond_picture(points * size, person) & any_pose

    def without_mistakes(values: Float[np.ndarray, "F L C"]) -> Float[np.ndarray, "F L C"]:
        good = ~(lost | jumped)
        filled = [_filled(values[:, m], good[:, m], places) for m in range(COUNT)]
        return np.where(guessed[..., None], values, np.stack(filled, axis=1))

    filled, world = without_mistakes(points), person.world
    if world is not None:
        exchanged = _exchanged(world.numpy().astype(np.float64), swapped)
        world = torch.from_numpy(without_mistakes(exchanged)).float()
    cleaned = replace(
        person,
        points=torch.from_numpy(filled * size).float(),
        visibility=torch.from_numpy(np.where(jumped, 0.0, visibility)).float(),
        world=world,
    )
    flags = Flags(*(torch.from_numpy(array) for array in (swapped, jumped, lost)))
    return CleanTrack(cleaned, flags)


def trust(flags: Flags, rows: Sequence[int]) -> Float[Tensor, " F"]:
    """Share of some landmarks, one at least, that nothing was wrong with, by frame."""
    bad = flags.jumped | flags.lost
    return 1 - bad[:, list(rows)].float().mean(1)


def _beyond_picture(
    pixels: Float[np.ndarray, "F L 2"], person: Landmarks
) -> Bool[np.ndarray, "F L"]:
    """Where somebody was found, and a landmark of hers outside the picture."""
    height, width = person.mattes.shape[1:]
    inside = (pixels >= 0).all(-1) & (pixels < (width, height)).all(-1)
    return ~inside & person.found.numpy()[:, None]


def _exchanged(
    values: Float[np.ndarray, "F L C"], swapped: Bool[np.ndarray, "F L"]
) -> Float[np.ndarray, "F L C"]:
    return np.where(swapped[..., None], values[:, list(MIRRORED)], values)


def _swapped_frames(
    points: Float[np.ndarray, "F L 2"],
    visibility: Float[np.ndarray, "F L"],
    group: tuple[int, ...],
) -> Bool[np.ndarray, " F"]:
    """Frames to exchange so that the group's way through the picture is shortest (Viterbi)."""
    chosen = list(group)
    either = [points[:, chosen], points[:, [MIRRORED[mark] for mark in chosen]]]
    sure = visibility[:, chosen]
    cost, back = np.array([0.0, SWAP_COST]), []
    for frame in range(1, len(points)):
        weight = np.minimum(sure[frame - 1], sure[frame])
        step = np.array(
            [
                [
                    (
                        weight * np.linalg.norm(either[b][frame] - either[a][frame - 1], axis=-1)
                    ).sum()
                    for a in (0, 1)
                ]
                for b in (0, 1)
            ]
        ) / max(weight.sum(), 1e-6)
        total = cost[None] + step
        back.append(total.argmin(1))
        cost = total.min(1) + np.array([0.0, SWAP_COST])
    states = [int(cost.argmin())]
    for choice in reversed(back):
        states.append(int(choice[states[-1]]))
    return np.array(states[::-1], bool)


def _jumps(
    points: Float[np.ndarray, "F 2"], seen: Bool[np.ndarray, " F"], pace: Pace
) -> Bool[np.ndarray, " F"]:
    """Detections that the cheapest way through the others leaves out.

    A way is a chain of detections; what it goes faster than `FAST` is its excess, and each one left
    out costs as well, so that a real kick stays and a jump there and back does not.
    """
    frames = np.flatnonzero(seen)
    places = pace.places.numpy()[frames]
    if len(frames) < 3:
        return np.zeros(len(points), bool)
    best = np.zeros(len(frames))
    before = np.full(len(frames), -1)
    for here in range(len(frames)):
        best[here] = JUMP_COST * here  # a chain that starts here leaves out all before
        low = max(0, here - GAP)
        earlier = np.arange(low, here)
        if not len(earlier):
            continue
        time = (places[here] - places[earlier]) * pace.interval
        way = np.linalg.norm(points[frames[here]] - points[frames[earlier]], axis=-1)
        # After a long loss a new track begins, wherever it is.
        excess = np.where(time > GAP * pace.interval, 0.0, (way - FAST * time).clip(0))
        cost = best[earlier] + excess + JUMP_COST * (here - earlier - 1)
        if cost.min() < best[here]:
            best[here], before[here] = cost.min(), earlier[cost.argmin()]
    last = int((best + JUMP_COST * np.arange(len(frames) - 1, -1, -1)).argmin())
    kept = np.zeros(len(points), bool)
    while last >= 0:
        kept[frames[last]] = True
        last = int(before[last])
    return seen & ~kept


def _filled(
    values: Float[np.ndarray, "F C"],
    good: Bool[np.ndarray, " F"],
    places: Float[np.ndarray, " F"],
) -> Float[np.ndarray, "F C"]:
    """What is not good becomes the straight line, over time, between its good neighbours."""
    if not good.any():
        return values
    known = places[good]
    return np.stack([np.interp(places, known, column[good]) for column in values.T], axis=-1)
