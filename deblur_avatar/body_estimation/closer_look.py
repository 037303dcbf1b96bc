"""Closer look: a person too small, or too bent, for a detector to find in whole frames.

A detector that shrinks frames to 224 pixels hardly sees who is 100 of 1,280 pixels tall. Where it
found nobody, she is looked for in windows that follow her from where she was found: she fills a
third of them or more. A person's size here is the longer side of the box around her landmarks.
"""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.body_estimation.landmarks import (
    Landmarks,
    PersonFinder,
    Sighting,
    landmarks_of,
    pose_finder,
)
from deblur_avatar.run import progress

logger = logging.getLogger(__name__)

ENOUGH = 0.95  # share of frames in which she is found: a closer look is not worth its time
RUN = 5  # frames in a row that agree: a person, and no mistake
REACH, DRIFT = 0.6, 0.1  # her sizes that she moves in a frame at most, and more for each one missed
RESIZED = 2.5  # times as large or as small as when she was last seen, at most
WINDOWS = (2.0, 3.0)  # their sides, in her sizes
SMALLEST = 64  # pixels of a window
GONE = 30  # frames in a row without her: she has left
SURE = 0.5  # visibility from which a landmark is believed, or a person by the median of hers
CLEAR = 0.8  # the same of who is seen in a window, where anything may look like a person
FEW = 5  # landmarks that are believed: fewer, and the box is that of all
SAMPLES, PARTS = 16, (2, 3)  # frames searched, where nobody was found at all; windows to a side


@dataclass(frozen=True)
class _Place:
    """Where a person is, and how large, pixels."""

    right: float
    down: float
    size: float

    @classmethod
    def of(cls, sighting: Sighting) -> "_Place":
        sure = sighting.visibility >= SURE
        points = sighting.points[sure] if sure.sum() >= FEW else sighting.points
        low, high = points.amin(0), points.amax(0)
        right, down = ((low + high) / 2).tolist()
        return cls(right, down, float((high - low).max()))

    def holds(self, sighting: Sighting, missed: int) -> bool:
        """Whether it is the same person, after so many frames without her."""
        other = _Place.of(sighting)
        way = ((self.right - other.right) ** 2 + (self.down - other.down) ** 2) ** 0.5
        larger, smaller = max(self.size, other.size), min(self.size, other.size)
        return way <= (REACH + DRIFT * missed) * self.size and larger <= RESIZED * smaller


def look_closer(frames: UInt8[Tensor, "F H W 3"], person: Landmarks) -> Landmarks:
    """Look once more for a person who was not found in many frames, or hardly in most of them.

    Args:
        frames: consecutive.
        person: found by MediaPipe's pose model; as another detector found her she stays.
    """
    sure = person.visibility.median() >= SURE
    if person.model is None or (sure and person.found.float().mean() >= ENOUGH):
        return person
    with pose_finder(person.model, follows=False) as find:
        return follow_closely(frames, person, find)


def follow_closely(
    frames: UInt8[Tensor, "F H W 3"], person: Landmarks, find: PersonFinder
) -> Landmarks:
    """Follow a person in windows from where she was found for sure.

    That is the surest run of frames that agree; from there it goes forth and back. What was found
    far from where she just was is somebody else or nobody, unless she had gone and a run begins
    there. Where no run is, windows of some frames are searched for her. Nothing changes where it
    would show her for sure in fewer frames than before, or in fewer than `RUN`.

    Args:
        frames: consecutive.
        person: found in some of them, or in none.
        find: the detector, for pictures without order.
    """
    first = [_sighting(person, index) for index in range(len(frames))]
    runs = _runs(first)
    start = max(runs, key=_sureness) if runs else _searched(frames, find)
    if not start:
        return person
    steady = {index for sightings in runs for index in sightings}
    seen: dict[int, Sighting] = dict(start)
    for way, last in (
        (range(max(start) + 1, len(frames)), max(start)),
        (range(min(start) - 1, -1, -1), min(start)),
    ):
        seen |= _followed(frames, first, steady, way, _Place.of(start[last]), find)
    if len(seen) < RUN or _sure_frames(seen.values()) < _sure_frames(first):
        return person
    logger.info(
        "looked closer: the person followed is in %d of %d frames, at first in %d",
        len(seen), len(frames), int(person.found.sum()),
    )  # fmt: skip
    count, height, width = frames.shape[:3]
    return landmarks_of(map(seen.get, range(count)), (count, height, width), person.model)


def _sighting(person: Landmarks, index: int) -> Sighting | None:
    if not person.found[index] or person.world is None:
        return None
    return Sighting(
        person.points[index], person.visibility[index], person.world[index], person.mattes[index]
    )


def _sure(sighting: Sighting) -> float:
    """The median landmark's visibility: half of a person may be hidden."""
    return float(sighting.visibility.median())


def _sure_frames(sightings: Iterable[Sighting | None]) -> int:
    return sum(sighting is not None and _sure(sighting) >= SURE for sighting in sightings)


def _sureness(sightings: Mapping[int, Sighting]) -> float:
    return sum(map(_sure, sightings.values()))


def _runs(sightings: Sequence[Sighting | None]) -> list[dict[int, Sighting]]:
    """Frames in a row that surely show one person, `RUN` or more."""
    runs: list[dict[int, Sighting]] = []
    last = None
    for index, sighting in enumerate(sightings):
        if sighting is None or _sure(sighting) < SURE:
            last = None
            continue
        if last is None or not _Place.of(last).holds(sighting, 0):
            runs.append({})
        runs[-1][index] = last = sighting
    return [run for run in runs if len(run) >= RUN]


def _followed(
    frames: UInt8[Tensor, "F H W 3"],
    first: Sequence[Sighting | None],
    steady: set[int],
    way: range,
    last: _Place,
    find: PersonFinder,
) -> dict[int, Sighting]:
    """The person in frame after frame, from where she was last seen."""
    seen: dict[int, Sighting] = {}
    missed = 0
    for index in progress(way, "a closer look"):
        sighting, gone = first[index], missed >= GONE
        if sighting is not None and not (
            last.holds(sighting, missed) or (gone and index in steady)
        ):
            sighting = None
        if not gone and (sighting is None or _sure(sighting) < SURE):
            sighting = _in_windows(frames[index], last, missed, find) or sighting
        if sighting is None:
            missed += 1
        else:
            seen[index], last, missed = sighting, _Place.of(sighting), 0
    return seen


def _in_windows(
    frame: UInt8[Tensor, "H W 3"], last: _Place, missed: int, find: PersonFinder
) -> Sighting | None:
    for side in WINDOWS:
        sighting = _within(frame, last.right, last.down, side * last.size, find)
        if sighting is not None and last.holds(sighting, missed):
            return sighting
    return None


def _within(
    frame: UInt8[Tensor, "H W 3"], right: float, down: float, side: float, find: PersonFinder
) -> Sighting | None:
    """Who is seen in a square about a point, in pixels of the frame."""
    height, width = frame.shape[:2]
    size = min(max(round(side), SMALLEST), height, width)
    left = min(max(round(right - size / 2), 0), width - size)
    top = min(max(round(down - size / 2), 0), height - size)
    rows, columns = slice(top, top + size), slice(left, left + size)
    found = find(frame[rows, columns])
    if found is None or _sure(found) < CLEAR:
        return None
    matte = torch.zeros(height, width, dtype=torch.uint8)
    matte[rows, columns] = found.matte
    return found._replace(points=found.points + torch.tensor([left, top]), matte=matte)


def _searched(frames: UInt8[Tensor, "F H W 3"], find: PersonFinder) -> dict[int, Sighting]:
    """The surest sighting in windows of some frames, by its frame; empty if there is none."""
    height, width = frames.shape[1:3]
    best: dict[int, Sighting] = {}
    surest = 0.0
    for index in progress(range(0, len(frames), -(-len(frames) // SAMPLES)), "a search"):
        for part in PARTS:
            side = min(height, width) / part
            for down in torch.arange(side / 2, height, side / 2).tolist():
                for right in torch.arange(side / 2, width, side / 2).tolist():
                    found = _within(frames[index], right, down, side, find)
                    if found is not None and _sure(found) > surest:
                        best, surest = {index: found}, _sure(found)
    return best
