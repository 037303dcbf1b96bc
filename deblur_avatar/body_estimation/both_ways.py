"""Both ways: a track forth in time and one back tell apart people whom each mixes up.

A detector that follows one person goes over to whoever passes in front of her without a jump: her
landmarks slide. The track back goes over there, too, but to the person whom the track forth left:
before and after, the two show both people at once. What these wear then, and where they are, tells
who is seen in all other frames.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import permutations
from math import inf, isnan
from statistics import fmean, median
from typing import NamedTuple

import torch

from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.body_estimation.same_person import (
    NEARER,
    RUN,
    UNLIKE,
    Look,
    Looks,
    colors_worn,
    is_one,
)
from deblur_avatar.imaging.overlap import soft_iou

APART = 0.2  # of the area that two mattes cover, covered by both, at most: two people
GAP = 2  # frames without a look from which on a person may have gone elsewhere
STEADY = 6.0  # CIELAB's difference of colours of one person in a row of frames, at most
BESIDE = 0.5  # sizes by which a place is nearer to one's than to any other's
WITHIN = 2.0  # sizes from where somebody was last seen, at most
STILL, FAR = 0.5, 1.0  # sizes: who has not moved, and how much farther all others were
TOLD = 0.6  # share of the track forth of which it must be known whom it shows
LEAST_SIZE = 0.4  # of the other's, that who is filmed has
LEAST_FRAMES = 1 / 3  # of the other's, in which who is filmed is seen
STAYS = 0.5  # of another's way across the picture, at most, is the way of who stays in place

Shown = tuple[Look, ...]  # people in one frame: one, or two, found forth and back
Stretch = dict[int, Shown]  # frames that show the same people
Seen = dict[int, Look]  # a person, by frame
Costs = Sequence[Sequence[float]]  # of each look of a stretch being each person's


def backward(track: Landmarks) -> Landmarks:
    """A track of frames in reverse order, as one of the frames in order, without hands and face."""
    flipped = {
        name: getattr(track, name).flip(0) for name in ("found", "points", "visibility", "mattes")
    }
    world = None if track.world is None else track.world.flip(0)
    return replace(track, **flipped, world=world, parts=None)


def told_apart(forth: Looks, back: Looks) -> list[Seen] | None:
    """Who is filmed, and then who passes by, where the track forth shows several people.

    A frame that does not tell who is seen, as while one passes before the other, is nobody's.

    Args:
        forth: who was found in each frame, one after the other.
        back: the same, found from the last frame to the first.

    Returns:
        All of them; nobody if too little tells them apart; None if the track forth shows one
        person, or the tracks never show two at once.
    """
    pairs = list(zip(map(_surely, forth), map(_surely, back), strict=True))
    found = _stretches(pairs)
    if len(found) == 1 or not any(len(part) >= RUN and _is_of_two(part) for part in found):
        return None
    stretches = [part for part in found if _is_steady(part)]
    two = [number for number, part in enumerate(stretches) if len(part) >= RUN and _is_of_two(part)]
    if not two:
        return []
    surest = max(two, key=lambda number: len(stretches[number]))
    known = _tracks(stretches[surest])
    if not _differ(*known):
        return []
    people = filmed_first(_people(stretches, surest, known))
    own = [sum(pair[0] is not None and seen.get(index) is pair[0]
               for index, pair in enumerate(pairs)) for seen in people]  # fmt: skip
    told = sum(own) >= TOLD * sum(here is not None for here, _ in pairs)
    if not told or not all(is_one(seen.values()) for seen in people):
        return []
    return people if sum(frames >= RUN for frames in own) > 1 else None


def _surely(look: Look | None) -> Look | None:
    return look if look is not None and look.is_sure else None


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
        if not goes_on or any(a.jumps_to(b, 1) for a, b in zip(before, looks, strict=True)):
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
    return () if here.jumps_to(there, 1) else (here,)


def _shared(here: Look, there: Look) -> float:
    """Of the area that two mattes cover, what both cover; all of it where they cover none."""
    shared = soft_iou(here.sighting.matte.float(), there.sighting.matte.float())
    return 1.0 if shared is None else shared


def _is_of_two(part: Stretch) -> bool:
    return len(next(iter(part.values()))) == 2


def _tracks(part: Stretch) -> list[list[Look]]:
    return [list(track) for track in zip(*part.values(), strict=True)]


def _is_steady(part: Stretch) -> bool:
    """Whether two wear in a stretch's last third what they wear in its first, if it is so long."""
    third = len(part) // 3
    if third < RUN or not _is_of_two(part):
        return True
    drifts = (
        min(median(found) if (found := _differences(*ends)) else 0.0
            for ends in ((track[:third], track[-third:]), (track[-third:], track[:third])))
        for track in _tracks(part)
    )  # fmt: skip
    return max(drifts) <= STEADY


def _differ(first: Sequence[Look], second: Sequence[Look]) -> bool:
    """Whether colours tell two people: those of most frames are none of the other's."""
    ways = (_differences(first, second), _differences(second, first))
    return all(apart and median(apart) >= NEARER for apart in ways)


def _differences(track: Sequence[Look], wearing: Sequence[Look]) -> list[float]:
    """Of looks that compare."""
    worn = colors_worn(wearing)
    found = (look.difference(worn) for look in track)
    return [difference for difference in found if not isnan(difference)]


def _people(stretches: Sequence[Stretch], surest: int, known: Sequence[list[Look]]) -> list[Seen]:
    """Who is seen in each frame, from the surest stretch of two on, forth and then back."""
    worn = list(known)
    people = [dict(zip(stretches[surest], track, strict=True)) for track in known]
    for way, numbers in ((1, range(surest + 1, len(stretches))), (-1, range(surest - 1, -1, -1))):
        farthest = max if way > 0 else min
        for part in map(stretches.__getitem__, numbers):
            begin = min(part) if way > 0 else max(part)
            last = [_Last(abs(begin - (at := farthest(seen))), seen[at]) for seen in people]
            order = _order(part, part[begin], worn, last)
            for who, track in zip(order, _tracks(part), strict=False):
                if who == len(people):
                    people.append({})
                    worn.append(track)
                people[who].update(zip(part, track, strict=True))
    return [dict(sorted(seen.items())) for seen in people]


class _Last(NamedTuple):
    """Where a person was last seen, and how many frames ago."""

    ago: int
    look: Look

    def may_be(self, here: Look) -> bool:
        """Whether she can have come there since."""
        return not self.look.jumps_to(here, self.ago)

    def way(self, here: Look) -> float:
        """How far she has come if she is there, in sizes of who is there."""
        return float((self.look.centre - here.centre).norm()) / here.size


def _order(
    part: Stretch, nearest: Shown, worn: Sequence[Sequence[Look]], last: Sequence[_Last]
) -> tuple[int, ...]:
    """Whom a stretch shows: numbers of people, the next free one for somebody new.

    Nobody jumps into another's place or clothes, where colours of all compare. What that leaves is
    told by places, where all were far apart and nobody has moved, which must be ahead of orders
    that jumps rule out, too; else by colours, which light may change; else by places that are less
    clear; else by both, each where it tells. Colours that nobody has worn are somebody new's.
    Nobody if nothing tells.

    Args:
        part: the stretch.
        nearest: its looks beside where all were last seen.
        worn: people, in frames that show them for sure.
        last: where they were last seen.
    """
    colors = _color_costs(part, worn)
    far = _too_far(nearest, last, colors) if colors else [set[int]()] * len(nearest)

    def is_steady(order: Sequence[int]) -> bool:
        return not any(who in others for who, others in zip(order, far, strict=True))

    everyone = list(permutations(range(len(last)), len(nearest)))
    orders = list(filter(is_steady, everyone))
    if orders:
        ways = [[seen.way(here) for seen in last] for here in nearest]
        by_place, way, ahead = _best(orders, ways, everyone)
        if way <= STILL and ahead >= FAR:
            return by_place
        by_colors = _named(orders, colors)
        if by_colors:
            return by_colors
        if way <= WITHIN and ahead >= BESIDE:
            return by_place
        by_both = _by_both(orders, ways, colors)
        if by_both:
            return by_both
    new = list(filter(is_steady, _with_new(everyone, len(worn))))
    return _named(new, colors) if new and len(part) >= RUN else ()


def _too_far(nearest: Shown, last: Sequence[_Last], colors: Costs) -> list[set[int]]:
    """Who a look is not: they would have jumped there, into other clothes or another's place.

    Another's place it is if she came there without a jump, nearer to it than to any other look, in
    colours that are hers as much as anybody's: a track that slides over to another person does not
    jump, either. Nobody new is there then.
    """
    found = []
    for here, costs in zip(nearest, colors, strict=True):
        near = {who for who, seen in enumerate(last) if seen.may_be(here)}
        taken = any(
            costs[who] <= UNLIKE
            and costs[who] - min(costs) < NEARER
            and last[who].way(here) == min(map(last[who].way, nearest))
            for who in near
        )
        others = set(range(len(costs))) - near
        found.append({who for who in others if taken or costs[who] > UNLIKE})
    return found


def _color_costs(part: Stretch, worn: Sequence[Sequence[Look]]) -> Costs | None:
    """Of each look and person, and in the last column of somebody new; None: not all compare."""
    apart = [[_differences(track, wearing) for wearing in worn] for track in _tracks(part)]
    if not all(found for row in apart for found in row):
        return None
    return [[*map(fmean, row), UNLIKE] for row in apart]


def _named(orders: Sequence[tuple[int, ...]], colors: Costs | None) -> tuple[int, ...]:
    """Whom colours name, clearly and with all in their own; nobody if they do not."""
    if colors is None:
        return ()
    order, _, ahead = _best(orders, colors, orders)
    return order if ahead >= NEARER and _in_their_own(order, colors) else ()


def _by_both(
    orders: Sequence[tuple[int, ...]], ways: Costs, colors: Costs | None
) -> tuple[int, ...]:
    """Whom colours name best, and against any other order either they or places name clearly."""
    if colors is None:
        return ()
    best = min(orders, key=partial(_cost, costs=colors))
    ahead = (
        _ahead(best, other, colors) >= NEARER or _ahead(best, other, ways) >= BESIDE
        for other in orders if other != best
    )  # fmt: skip
    return best if _in_their_own(best, colors) and all(ahead) else ()


def _in_their_own(order: Sequence[int], colors: Costs) -> bool:
    """Whether all wear what may be theirs."""
    return all(row[who] <= UNLIKE for row, who in zip(colors, order, strict=True))


def _best(
    orders: Sequence[tuple[int, ...]], costs: Costs, among: Sequence[tuple[int, ...]]
) -> tuple[tuple[int, ...], float, float]:
    """The order that costs least, its costs on average, and how far it is ahead of the next one.

    Args:
        orders: to choose from.
        costs: of each look being each person's.
        among: what it is compared with.
    """
    best = min(orders, key=partial(_cost, costs=costs))
    others = (_ahead(best, other, costs) for other in among if other != best)
    return best, _cost(best, costs), min(others, default=inf)


def _cost(order: Sequence[int], costs: Costs) -> float:
    return fmean(row[who] for row, who in zip(costs, order, strict=True))


def _ahead(order: Sequence[int], other: Sequence[int], costs: Costs) -> float:
    """How much more another order costs, on average over the looks on which the two differ."""
    return fmean(
        row[theirs] - row[who]
        for row, who, theirs in zip(costs, order, other, strict=True) if who != theirs
    )  # fmt: skip


def _with_new(orders: Sequence[tuple[int, ...]], new: int) -> list[tuple[int, ...]]:
    """Orders of which one person is new; and those of one person, who may be known after all."""
    changed = (
        (*order[:place], new, *order[place + 1 :])
        for order in orders for place in range(len(order))
    )  # fmt: skip
    known = orders if len(orders[0]) == 1 else ()
    return list(dict.fromkeys([*changed, *known]))


def filmed_first(people: Sequence[Seen]) -> list[Seen]:
    """People, the one who is filmed before all others.

    She is kept in the picture while others cross it: she moves less across it. Where nobody clearly
    does, it is the larger, longer seen one, as it is where she is very much larger or seen very
    much longer.
    """
    major = [
        one for one in people
        if not any(_is_minor(one, other) and not _is_minor(other, one) for other in people)
    ] or people  # fmt: skip
    least = min(map(_way, major))
    filmed = max((seen for seen in major if STAYS * _way(seen) <= least), key=_extent)
    return [filmed, *(seen for seen in people if seen is not filmed)]


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
