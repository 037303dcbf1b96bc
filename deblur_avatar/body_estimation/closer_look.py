"""Closer look: a person too small or too bent to be found in whole frames, or lost to another.

A detector that shrinks frames to 224 pixels hardly sees who is 100 of 1,280 pixels tall, and in a
crowd it goes over from one person to the next. Where it found nobody, or somebody else, she is
looked for in windows that follow her from where she was found: she fills a third of them or more.
"""

import logging
from collections.abc import Iterable, Mapping, Sequence

import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.body_estimation.landmarks import (
    Landmarks,
    PersonFinder,
    pose_finder,
)
from deblur_avatar.body_estimation.same_person import (
    RUN,
    SURE,
    Look,
    Looks,
    is_one,
    is_same,
    looks_of,
    track_of,
)
from deblur_avatar.run import progress

logger = logging.getLogger(__name__)

ENOUGH = 0.95  # share of frames in which she is found: a closer look is not worth its time
WINDOWS = (2.0, 3.0)  # their sides, in her sizes
SMALLEST = 64  # pixels of a window
GONE = 30  # frames in a row without her: she has left
CLEAR = 0.8  # sureness of who is seen in a window, where anything may look like a person
SAMPLES, PARTS = 16, (2, 3)  # frames searched, where nobody was found at all; windows to a side


def look_closer(
    frames: UInt8[Tensor, "F H W 3"], person: Landmarks, other: Landmarks | None = None
) -> Landmarks:
    """Look once more for a person who was not found in many frames, hardly, or not always herself.

    Args:
        frames: consecutive.
        person: found by MediaPipe's pose model; as another detector found her she stays.
        other: whom else it found; the person herself, where both were mixed up.
    """
    if person.model is None:
        return person
    sure = person.visibility.median() >= SURE
    if sure and person.found.float().mean() >= ENOUGH and is_one(looks_of(person, frames)):
        return person
    with pose_finder(person.model, follows=False) as find:
        return follow_closely(frames, person, find, other)


def follow_closely(
    frames: UInt8[Tensor, "F H W 3"],
    person: Landmarks,
    find: PersonFinder,
    other: Landmarks | None = None,
) -> Landmarks:
    """Follow a person in windows from where she was found for sure.

    That is the surest run of frames that agree, with all in the same clothes; from there it goes
    forth and back. What was found far from where she just was, or in other clothes, is somebody
    else or nobody, unless she had gone and a run begins there. Where no run is, windows of some
    frames are searched for her. Where it would show her for sure in fewer frames than before, or in
    fewer than `RUN`, nothing changes but that who surely wears other clothes is left out, if she
    herself is surely seen more often.

    Args:
        frames: consecutive.
        person: found in some of them, or in none.
        find: the detector, for pictures without order.
        other: whom else it found, where that was looked for.
    """
    tracks = [looks_of(track, frames) for track in (person, other) if track is not None]
    first = tracks[0]
    runs_of_all = [_runs(track) for track in tracks]
    runs = runs_of_all[0]
    start = _surest(runs) if runs else _searched(frames, find)
    if not start:
        return person
    steady = [{index for run in found for index in run} for found in runs_of_all]
    seen = dict(start)
    for way in (range(max(start) + 1, len(frames)), range(min(start) - 1, -1, -1)):
        _follow(frames, list(zip(tracks, steady, strict=True)), way, seen, find)
    strangers = _strangers(first, seen) if runs else set()
    herself = [None if index in strangers else look for index, look in enumerate(first)]
    if len(seen) < RUN or _sure_frames(seen.values()) < _sure_frames(herself):
        if not strangers:
            return person
        kept = {index: look for index, look in enumerate(herself) if look is not None}
        seen = {index: seen[index] for index in strangers & seen.keys()} | kept
    if strangers:
        logger.warning("in %d frames somebody else was followed, who is left out", len(strangers))
    logger.info(
        "looked closer: the person followed is in %d of %d frames, at first in %d",
        len(seen), len(frames), int(person.found.sum()),
    )  # fmt: skip
    return track_of(seen, person)


def look_beside(
    frames: UInt8[Tensor, "F H W 3"],
    hers: Mapping[int, Look],
    others: Sequence[Look],
    find: PersonFinder,
) -> dict[int, Look]:
    """Look for a person wherever she is not known to be seen, but not for others who pass her.

    In windows about where she was last; who is found there is she if colours say so.

    Args:
        frames: consecutive.
        hers: the frames in which she is known.
        others: in what others are seen.
        find: the detector, for pictures without order.

    Returns:
        `hers`, and the frames in which she was found besides.
    """
    known, seen = list(hers.values()), dict(hers)
    for way in (range(min(hers), len(frames)), range(max(hers), -1, -1)):
        last, missed = seen[way.start], 0
        for index in progress(way, "a look beside who passes"):
            look = seen.get(index)
            if look is None and missed < GONE:
                look = _in_windows(frames[index], [*known, last], missed, find)
                if look is not None and not _is_clearly(look, known, others):
                    look = None
            if look is None:
                missed += 1
            else:
                seen[index] = last = look
                missed = 0
    return dict(sorted(seen.items()))


def _is_clearly(look: Look, known: Sequence[Look], others: Sequence[Look]) -> bool:
    """Whether colours are hers and neither those of others nor somebody unknown's."""
    return look.is_rather(known, others) and not look.is_unlike(known)


def _sure_frames(looks: Iterable[Look | None]) -> int:
    return sum(look is not None and look.is_sure for look in looks)


def _surest(runs: Sequence[dict[int, Look]]) -> dict[int, Look]:
    """The run that is surest with all in its clothes; of those the one that is surest by itself."""

    def sureness(run: Mapping[int, Look]) -> float:
        return sum(look.sureness for look in run.values())

    def with_others(run: Mapping[int, Look]) -> float:
        looks = list(run.values())
        return sum(sureness(one) for one in runs if not next(iter(one.values())).is_unlike(looks))

    return max(runs, key=lambda run: (with_others(run), sureness(run)))


def _strangers(first: Looks, seen: Mapping[int, Look]) -> set[int]:
    """Frames that surely showed somebody in other clothes; none, where those are the most."""
    looks = list(seen.values())
    frames = {
        index for index, look in enumerate(first)
        if look is not None and look.is_sure and seen.get(index) is not look
        and look.is_unlike(looks)
    }  # fmt: skip
    return frames if len(frames) < _sure_frames(looks) else set()


def _runs(looks: Looks) -> list[dict[int, Look]]:
    """Frames in a row that surely show one person, `RUN` or more."""
    runs: list[dict[int, Look]] = []
    goes_on = False
    for index, look in enumerate(looks):
        if look is None or not look.is_sure:
            goes_on = False
            continue
        if not (goes_on and is_same(look, list(runs[-1].values()), 0)):
            runs.append({})
        runs[-1][index] = look
        goes_on = True
    return [run for run in runs if len(run) >= RUN]


def _follow(
    frames: UInt8[Tensor, "F H W 3"],
    tracks: Sequence[tuple[Looks, set[int]]],
    way: range,
    seen: dict[int, Look],
    find: PersonFinder,
) -> None:
    """Add the person in frame after frame from where she was seen, next to where `way` begins.

    Args:
        tracks: who was found before, and in which frames as one of a run.
    """
    missed = 0
    known = [seen[index] for index in sorted(seen, reverse=way.step < 0)]
    for index in progress(way, "a closer look"):
        gone = missed >= GONE
        look = None
        for looks, steady in tracks:
            here = looks[index]
            if look is None and here is not None and (
                is_same(here, known, missed)
                or (gone and index in steady and not here.is_unlike(known))
            ):  # fmt: skip
                look = here
        if not gone and (look is None or not look.is_sure):
            look = _in_windows(frames[index], known, missed, find) or look
        if look is None:
            missed += 1
        else:
            seen[index] = look
            known.append(look)
            missed = 0


def _in_windows(
    frame: UInt8[Tensor, "H W 3"], known: Sequence[Look], missed: int, find: PersonFinder
) -> Look | None:
    last = known[-1]
    right, down = last.centre.tolist()
    for side in WINDOWS:
        look = _within(frame, right, down, side * last.size, find)
        if look is not None and is_same(look, known, missed):
            return look
    return None


def _within(
    frame: UInt8[Tensor, "H W 3"], right: float, down: float, side: float, find: PersonFinder
) -> Look | None:
    """Who is seen in a square about a point, in pixels of the frame."""
    height, width = frame.shape[:2]
    size = min(max(round(side), SMALLEST), height, width)
    left = min(max(round(right - size / 2), 0), width - size)
    top = min(max(round(down - size / 2), 0), height - size)
    rows, columns = slice(top, top + size), slice(left, left + size)
    found = find(frame[rows, columns])
    if found is None or found.visibility.median() < CLEAR:
        return None
    matte = torch.zeros(height, width, dtype=torch.uint8)
    matte[rows, columns] = found.matte
    points = found.points + torch.tensor([left, top])
    return Look.of(found._replace(points=points, matte=matte), frame)


def _searched(frames: UInt8[Tensor, "F H W 3"], find: PersonFinder) -> dict[int, Look]:
    """The surest look in windows of some frames, by its frame; empty if there is none."""
    height, width = frames.shape[1:3]
    best: dict[int, Look] = {}
    surest = 0.0
    for index in progress(range(0, len(frames), -(-len(frames) // SAMPLES)), "a search"):
        for part in PARTS:
            side = min(height, width) / part
            for down in torch.arange(side / 2, height, side / 2).tolist():
                for right in torch.arange(side / 2, width, side / 2).tolist():
                    found = _within(frames[index], right, down, side, find)
                    if found is not None and found.sureness > surest:
                        best, surest = {index: found}, found.sureness
    return best
