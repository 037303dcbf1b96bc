"""Main person: whom to follow where a detector sees one at a time and several are there.

Such a detector may lock on to a bystander. So the person it found is hidden and it is asked again,
on some frames; if another one is larger and longer in the picture, that one is followed. And it may
go over to who passes in front: where anybody else is seen, it is asked from the last frame to the
first, too, and the two tracks tell people apart.
"""

import logging

import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.body_estimation.both_ways import backward, filmed_first, told_apart
from deblur_avatar.body_estimation.closer_look import look_beside, look_closer
from deblur_avatar.body_estimation.landmarks import Landmarks, PersonDetector, pose_finder
from deblur_avatar.body_estimation.same_person import SURE, looks_of, track_of

logger = logging.getLogger(__name__)

SAMPLES = 16  # frames on which others are looked for
SEEN_SHARE = 0.3  # of them in which someone else must be found to be more than a mistake
MARGIN = 0.1  # around a person, as a share of her height, that is hidden with her


def detect_main_person(
    frames: UInt8[Tensor, "F H W 3"], detect: PersonDetector
) -> tuple[Landmarks, int]:
    """Find the larger, longer-tracked of two people; look closer where it is not she, or nobody.

    Where the detector went over to who passed by, she is who moves less across the picture.

    Returns:
        That person, and how many people there are, as far as they were looked for.
    """
    first = detect(frames)
    if not first.found.any():
        person = look_closer(frames, first)
        return person, int(person.found.any())
    step = max(1, len(frames) // SAMPLES)
    sample = slice(None, None, step)
    other = detect(_hidden(frames[sample], _part(first, sample)))
    if (other.visibility.median(1).values >= SURE).any():
        told = _told_from_others(frames, first, detect)
        if told is not None:
            return told
    if other.found.float().mean() < SEEN_SHARE or _size(other) == 0:
        return look_closer(frames, first), 1
    if _size(other) <= _size(_part(first, sample)):
        logger.warning("two people; the larger, longer-tracked one is taken")
        return look_closer(frames, first), 2
    second = detect(_hidden(frames, first))
    logger.warning("two people; the first one found is the smaller or less seen and is left out")
    return look_closer(frames, second, first), 2


def _told_from_others(
    frames: UInt8[Tensor, "F H W 3"], first: Landmarks, detect: PersonDetector
) -> tuple[Landmarks, int] | None:
    """Who is filmed, and how many people there are, where a track shows several; None if not."""
    if first.world is None:
        return None
    back = backward(detect(frames.flip(0)))
    people = told_apart(looks_of(first, frames), looks_of(back, frames))
    if people is None:
        return None
    if not people:
        logger.warning(
            "several people are seen at once, and too little tells them apart: the one who is "
            "followed may be now one and now the other; look at check.png, and bring masks and "
            "keypoints or choose frames with one person",
        )
        return None
    if first.model is not None:
        with pose_finder(first.model, follows=False) as find:
            people = [
                look_beside(frames, seen, [look for other in people if other is not seen
                                           for look in other.values()], find)
                for seen in people
            ]  # fmt: skip
    filmed = filmed_first(people)[0]
    logger.warning(
        "%d people, whom the detector mixed up: one is followed in %d frames, and who else is "
        "there is left out; look at check.png; to follow somebody else bring masks and keypoints, "
        "or choose frames without the others", len(people), len(filmed),
    )  # fmt: skip
    return track_of(filmed, first), len(people)


def _part(person: Landmarks, frames: slice) -> Landmarks:
    return Landmarks(
        person.found[frames], person.points[frames], person.visibility[frames],
        person.mattes[frames],
    )  # fmt: skip


def _size(person: Landmarks) -> float:
    """Height in the picture, summed over the frames that surely show the person."""
    sure = person.visibility >= SURE
    rows = person.points[..., 1]
    low = torch.where(sure, rows, torch.inf).amin(1)
    high = torch.where(sure, rows, -torch.inf).amax(1)
    heights = torch.where(sure.any(1) & person.found, high - low, 0.0)
    return float(heights.sum())


def _hidden(frames: UInt8[Tensor, "F H W 3"], person: Landmarks) -> UInt8[Tensor, "F H W 3"]:
    """Frames with the person's box painted over in the frame's mean colour."""
    hidden = frames.clone()
    height, width = frames.shape[1:3]
    for index in torch.nonzero(person.found).flatten().tolist():
        points = person.points[index]
        margin = MARGIN * float(points[:, 1].amax() - points[:, 1].amin()) + 1
        left, top = (points.amin(0) - margin).floor().long().tolist()
        right, bottom = (points.amax(0) + margin).ceil().long().tolist()
        rows = slice(max(0, top), max(0, min(height, bottom)))
        columns = slice(max(0, left), max(0, min(width, right)))
        mean = frames[index].float().mean((0, 1)).round().to(torch.uint8)
        hidden[index, rows, columns] = mean
    return hidden
