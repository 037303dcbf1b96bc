"""Both ways: a track forth in time and one back tell apart two people whom each mixes up.

A detector that follows one person goes over to whoever passes in front of her without a jump: her
landmarks slide. The track back goes over there, too, but to the person whom the track forth left:
before and after, the two show both people at once. What these wear then, and where they are, tells
who is seen in all other frames.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import isnan
from statistics import fmean, median

import torch

from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.body_estimation.same_person import SURE, UNLIKE, Look, is_one

APART = 0.2  # of the area that two mattes cover, covered by both, at most: two people
RUN = 5  # frames that show two people, one of whom is known from then on
GAP = 2  # frames without a look from which on a person may have gone elsewhere
NEARER = 2.0  # CIELAB's difference by which colours are one person's and not the other's
BESIDE = 0.5  # sizes by which a place is nearer to one's than to the other's
WITHIN = 2.0  # sizes from where somebody was last seen, at most
STILL, FAR = 0.5, 1.0  # sizes: who has not moved, and how much farther the other was
TOLD = 0.6  # share of the track forth of which it must be known whom it shows
LEAST_SIZE = 0.4  # of the other's, that who is filmed has
LEAST_FRAMES = 1 / 3  # of the other's, in which who is filmed is seen
STAYS = 0.5  # of the other's way across the picture, at most, is the way of who stays in place

Looks = Sequence[Look | None]  # of a track, frame after frame
Shown = tuple[Look, ...]  # people in one frame: one, or two, found forth and back
Stretch = dict[int, Shown]  # frames that show the same people
Seen = dict[int, Look]  # a person, by frame


def backward(track: Landmarks) -> Landmarks:
    """A track of frames in reverse order, as one of the frames in order, without hands and face."""
    flipped = {
        name: getattr(track, name).flip(0) for name in ("found", "points", "visibility", "mattes")
    }
    world = None if track.world is None else track.world.flip(0)
    return replace(track, **flipped, world=world, parts=None)


def told_apart(forth: Looks, back: Looks) -> tuple[Seen, Seen] | None:
    """Who is filmed and who passes by, where the track forth shows both.

    Who is filmed is kept in the picture while the other crosses it: she moves less across it. Where
    neither clearly does, it is the larger, longer seen one, as it is where the other is very much
    larger or seen very much longer. A frame that does not tell who is seen, as while one passes
    before the other, is neither's.

    Args:
        forth: who was found in each frame, one after the other.
        back: the same, found from the last frame to the first.

    Returns:
        Both; None if the track forth shows one person, or too little tells them apart, or more than
        two are there: one of them would wear several clothes.
    """
    pairs = list(zip(map(_surely, forth), map(_surely, back), strict=True))
    stretches = _stretches(pairs)
    two = [number for number, part in enumerate(stretches) if len(part) >= RUN and _is_of_two(part)]
    if not two:
        return None
    surest = max(two, key=lambda number: len(stretches[number]))
    known = _tracks(stretches[surest])
    if not _differ(*known):
        return None
    people = _people(stretches, surest, known)
    own = [sum(pair[0] is not None and seen.get(index) is pair[0]
               for index, pair in enumerate(pairs)) for seen in people]  # fmt: skip
    if min(own) < RUN or sum(own) < TOLD * sum(here is not None for here, _ in pairs):
        return None
    return _filmed_first(*people) if all(is_one(seen.values()) for seen in people) else None


def _surely(look: Look | None) -> Look | None:
    return look if look is not None and look.sureness >= SURE else None


def _stretches(pairs: Sequence[tuple[Look | None, Look | None]]) -> list[Stretch]:
    """Frames in a row that show one person, or two, none of whom jumps; unsure ones left out."""
    stretches: list[Stretch] = []
    last = -GAP
    for index, pair in enumerate(pairs):
        looks = _shown(*pair)
        if not looks:
            continue
        before = stretches[-1][last] if stretches else ()
        goes_on = index - last < GAP + 1 and len(before) == len(looks)
        if not goes_on or any(a.jumps_to(b) for a, b in zip(before, looks, strict=True)):
            stretches.append({})
        stretches[-1][index] = looks
        last = index
    return stretches


def _shown(here: Look | None, there: Look | None) -> Shown:
    """One person or two, forth first; nobody where the tracks do not agree on one."""
    if here is None or there is None:
        return tuple(look for look in (here, there) if look is not None)
    if _shared(here, there) <= APART:
        return here, there
    return () if here.jumps_to(there) else (here,)


def _shared(here: Look, there: Look) -> float:
    """Of the area that two mattes cover, what both cover; all of it where they cover none."""
    one, other = (look.sighting.matte.float() for look in (here, there))
    either = float(torch.maximum(one, other).sum())
    return float(torch.minimum(one, other).sum()) / either if either else 1.0


def _is_of_two(part: Stretch) -> bool:
    return len(next(iter(part.values()))) == 2


def _tracks(part: Stretch) -> list[list[Look]]:
    return [list(track) for track in zip(*part.values(), strict=True)]


def _differ(first: Sequence[Look], second: Sequence[Look]) -> bool:
    """Whether colours tell two people: those of most frames are none of the other's."""
    ways = (_differences(first, second), _differences(second, first))
    return all(apart and median(apart) >= NEARER for apart in ways)


def _differences(track: Sequence[Look], wearing: Sequence[Look]) -> list[float]:
    """Of looks that compare."""
    found = (look.difference(wearing) for look in track)
    return [difference for difference in found if not isnan(difference)]


def _people(
    stretches: Sequence[Stretch], surest: int, known: Sequence[Sequence[Look]]
) -> tuple[Seen, Seen]:
    """Who is seen in each frame, from the surest stretch on, forth and then back."""
    people: tuple[Seen, Seen] = {}, {}
    for way, numbers in ((1, range(surest, len(stretches))), (-1, range(surest, -1, -1))):
        last = list(stretches[surest][(min, max)[way > 0](stretches[surest])])
        for number in numbers:
            part = stretches[number]
            frames = sorted(part)[::way]
            order = (0, 1) if number == surest else _order(part, part[frames[0]], known, last)
            for index in frames if order else ():
                for who, look in zip(order or (), part[index], strict=True):
                    people[who][index] = last[who] = look
    return tuple(dict(sorted(seen.items())) for seen in people)  # type: ignore[return-value]


def _order(
    part: Stretch, nearest: Shown, known: Sequence[Sequence[Look]], last: Sequence[Look]
) -> tuple[int, ...] | None:
    """Whom a stretch shows, 0 or 1.

    By their places where both were far apart and nobody has moved; else by their colours, which
    light may change; and if these do not tell by places that are less clear.

    Args:
        part: the stretch.
        nearest: its looks beside where both were last seen.
        known: both, in frames that show them.
        last: looks of both where they were last seen.
    """
    orders = ((0, 1), (1, 0)) if len(nearest) == 2 else ((0,), (1,))
    ways = [
        fmean(float((look.centre - last[who].centre).norm()) / look.size
              for who, look in zip(order, nearest, strict=True))
        for order in orders
    ]  # fmt: skip
    by_place = orders[ways.index(min(ways))]
    if min(ways) <= STILL and abs(ways[0] - ways[1]) >= FAR:
        return by_place
    colors = [
        [apart for who, track in zip(order, _tracks(part), strict=True)
         for apart in _differences(track, known[who])]
        for order in orders
    ]  # fmt: skip
    if all(colors):
        means = [fmean(found) for found in colors]
        if min(means) <= UNLIKE and abs(means[0] - means[1]) >= NEARER:
            return orders[means.index(min(means))]
    clear = min(ways) <= WITHIN and abs(ways[0] - ways[1]) >= BESIDE
    return by_place if clear else None


def _filmed_first(first: Seen, second: Seen) -> tuple[Seen, Seen]:
    minor = _is_minor(first, second), _is_minor(second, first)
    if minor[0] != minor[1]:
        return (second, first) if minor[0] else (first, second)
    ways = _way(first), _way(second)
    if min(ways) < STAYS * max(ways):
        return (first, second) if ways[0] < ways[1] else (second, first)
    return (first, second) if _extent(first) >= _extent(second) else (second, first)


def _is_minor(one: Seen, other: Seen) -> bool:
    """Whether somebody is much smaller than the other, or seen much less."""
    smaller = _size(one) < LEAST_SIZE * _size(other)
    return smaller or len(one) < LEAST_FRAMES * len(other)


def _size(seen: Seen) -> float:
    return median(look.size for look in seen.values())


def _extent(seen: Seen) -> float:
    """Her size, summed over the frames that show her."""
    return sum(look.size for look in seen.values())


def _way(seen: Seen) -> float:
    """How far a person gets from where she mostly is, in her sizes: the median of her frames."""
    centres = torch.stack([look.centre for look in seen.values()])
    ways = (centres - centres.median(0).values).norm(dim=1)
    return float(ways.median()) / _size(seen)
