"""Two people are coloured squares here: she stays, and the other walks past in front of her."""

from dataclasses import replace

import pytest
import torch

from deblur_avatar.body_estimation import same_person
from deblur_avatar.body_estimation.both_ways import (
    LEAST_FRAMES,
    TOLD,
    backward,
    filmed_first,
    told_apart,
)
from deblur_avatar.body_estimation.landmarks import COUNT, Landmarks, Sighting, landmarks_of
from deblur_avatar.body_estimation.same_person import NEARER, RUN, UNLIKE, Look, colors_worn

HEIGHT, WIDTH, FRAMES, SIZE = 80, 400, 30, 40
STAYS = 200.0  # pixels from the left
WHITE, PINK, BLUE = (255, 255, 255), (255, 235, 235), (0, 0, 255)
BETWEEN = (255, 245, 245)


@pytest.fixture(autouse=True)
def squares_have_colours(monkeypatch):
    monkeypatch.setattr(same_person, "TOO_SMALL", 10)
    monkeypatch.setattr(same_person, "JUMP", 0.4)  # so that 30 frames are enough to walk past


def look(who, index, size=SIZE, worn=(WHITE, PINK), away=None):
    """Her (S), her hardly seen (s), who walks past (W), the same (w), or nobody (-)."""
    if who == "-":
        return None
    stays = who in "Ss"
    right = STAYS if stays else away or 380.0 - 12.4 * index
    size = size if stays else SIZE
    left, top = max(int(right - size / 2), 0), (HEIGHT - size) // 2
    matte = torch.zeros(HEIGHT, WIDTH, dtype=torch.uint8)
    matte[top : top + size, left : left + size] = 255
    share = torch.linspace(0, 1, COUNT)[:, None]
    points = torch.tensor([left, top]) + share * size
    visibility = torch.full((COUNT,), 0.9 if who.isupper() else 0.3)
    frame = (matte[..., None] > 0) * torch.tensor(worn[0 if stays else 1], dtype=torch.uint8)
    return Look.of(Sighting(points, visibility, torch.ones(COUNT, 3), matte), frame)


def track(whom, **how):
    return [look(who, index, **how) for index, who in enumerate(whom)]


FORTH = "S" * 12 + "W" * 18  # goes over to who walks past, where they meet
BACK = "W" * 18 + "S" * 12


def whom(seen):
    """As letters; nobody where there is no look."""
    return "".join(
        "-" if index not in seen else "S" if float(seen[index].centre[0]) == STAYS else "W"
        for index in range(FRAMES)
    )


def test_who_is_passed_is_told_from_who_passes():
    filmed, passing = told_apart(track(FORTH), track(BACK))
    assert whom(filmed) == "S" * 12 + "-" * 6 + "S" * 12
    assert whom(passing) == "W" * FRAMES


def test_a_passer_by_who_comes_and_leaves_again():
    filmed, passing = told_apart(
        track("S" * 12 + "W" * 12 + "S" * 6), track("S" * 6 + "W" * 12 + "S" * 12)
    )
    assert whom(filmed) == "S" * 12 + "-" * 6 + "S" * 12
    assert whom(passing) == "-" * 6 + "W" * 18 + "-" * 6


def test_both_tracks_may_go_over_at_once():
    filmed, passing = told_apart(track("S" * 12 + "W" * 6 + "S" * 12), track(BACK))
    assert whom(filmed) == "S" * 12 + "-" * 6 + "S" * 12
    assert whom(passing) == "W" * 18 + "-" * 12


@pytest.mark.parametrize(
    ("forth", "back"),
    [
        ("S" * 30, "S" * 30),
        ("W" * 30, "W" * 30),
        ("S" * 30, "W" * 30),
        ("S" * 30, "W" * 12 + "S" * 18),
        ("S" * 30, "S" * 12 + "W" * 18),
        ("S" * 30, "-" * 30),
        ("-" * 30, "-" * 30),
        ("s" * 12 + "W" * 18, "W" * 18 + "s" * 12),
    ],
)
def test_a_track_forth_that_shows_one_person_is_hers(forth, back):
    assert told_apart(track(forth), track(back)) is None


@pytest.mark.parametrize("frames", [RUN - 1, RUN])
def test_fewer_frames_than_a_run_show_nobody(frames):
    forth = "S" * frames + "W" * (FRAMES - frames)
    assert (told_apart(track(forth), track("W" * FRAMES)) is None) == (frames < RUN)
    back = "W" * (12 + frames) + "S" * (18 - frames)
    at_last = "W" * 25 + "S" * frames + "-" * (5 - frames)
    assert (told_apart(track(at_last), track(back)) is None) == (frames < RUN)


def test_two_who_are_hardly_ever_seen_at_once_are_not_known():
    forth = "S" * 13 + "W" * 17
    assert told_apart(track(forth), track("S" * (14 - RUN) + "W" * (16 + RUN))) is None
    assert told_apart(track(forth), track("S" * (13 - RUN) + "W" * (17 + RUN))) is not None


def test_two_who_wear_the_same_are_not_told_apart():
    worn = (WHITE, WHITE)
    assert told_apart(track(FORTH, worn=worn), track(BACK, worn=worn)) == []
    nearly = (WHITE, (255, 252, 252))  # by 1.5
    assert told_apart(track(FORTH, worn=nearly), track(BACK, worn=nearly)) == []
    apart = {"worn": nearly, "away": 330.0}  # where places would tell, if they never meet
    assert told_apart(track(FORTH, **apart), track(BACK, **apart)) == []


@pytest.mark.parametrize(("unseen", "hers"), [(0, "W" * 6), (1, "-" * 6)])
def test_colours_between_both_s_are_nobody_s_but_who_was_just_seen(unseen, hers):
    forth, back = track(FORTH), track(BACK)
    for index in range(12, 18):
        between = look("W", index, worn=(BETWEEN, BETWEEN)) if index >= 12 + unseen else None
        forth[index] = back[index] = between
    filmed, passing = told_apart(forth, back)
    assert whom(filmed) == "S" * 12 + "-" * 6 + "S" * 12
    assert whom(passing) == "W" * 12 + hers + "W" * 12


@pytest.mark.parametrize("frames", [RUN - 1, RUN])
def test_colours_that_nobody_has_worn_are_somebody_else_s_if_seen_for_a_while(frames):
    forth, back = track(FORTH), track(BACK)
    third = range(13, 13 + frames)
    for index in third:
        forth[index] = back[index] = look("W", index, worn=(BLUE, BLUE))
    for index in (12, 13 + frames):
        forth[index] = back[index] = None
    people = told_apart(forth, back)
    assert [set(whom(seen)) - {"-"} for seen in people[:2]] == [{"S"}, {"W"}]
    assert not set(third) & (people[0].keys() | people[1].keys())
    assert [list(seen) for seen in people[2:]] == [list(third)] * (frames == RUN)


WIDE = {"L": 60.0, "M": 200.0, "R": 340.0}  # three slim people side by side, pixels
NARROW = {"L": 182.0, "M": 200.0, "R": 218.0}  # farther than people move in a frame
CLOSE = {"L": 180.0, "M": 203.0, "R": 217.0}  # but for two of them
WORN = {"L": (255, 251, 251), "M": BLUE, "R": WHITE}  # two of them nearly the same


def beside(whom, centres, worn=WORN):
    """Who is seen in each frame of three who stay side by side."""
    looks = [
        None if who == "-" else look("W", index, away=centres[who], worn=(WHITE, worn[who]))
        for index, who in enumerate(whom)
    ]
    for seen in looks:
        if seen is not None:
            middle = int(seen.centre[0])
            seen.sighting.matte[:, : middle - 6] = seen.sighting.matte[:, middle + 6 :] = 0
    return looks


def named(people, centres):
    """As letters, by place: who each of them is, and in which frames."""
    names = {centre: name for name, centre in centres.items()}
    return {"".join({names[float(at.centre[0])] for at in one.values()}): list(one)
            for one in people}  # fmt: skip


@pytest.mark.parametrize("unseen", [0, 1, 4])
@pytest.mark.parametrize("centres", [CLOSE, NARROW, WIDE], ids=["close", "narrow", "wide"])
def test_one_of_three_side_by_side_is_followed_while_the_track_back_changes(centres, unseen):
    """Two wear nearly the same, and places tell little: she is who was just seen there."""
    forth = beside("R" * 21 + "---" + "M" * 6, centres)
    back = beside("L" * 12 + "-" * unseen + "M" * (9 - unseen) + "---" + "R" * 6, centres)
    assert named(told_apart(forth, back), centres) == {
        "R": [*range(21), *range(24, FRAMES)],
        "L": list(range(12)),
        "M": [*range(12 + unseen, 21), *range(24, FRAMES)],
    }


def test_who_slides_over_to_the_other_does_not_stay_who_she_is():
    """Her landmarks hardly move, but colours are the other's at once."""
    forth, back = track(FORTH), track(BACK)
    for index, right in zip(range(12, 15), (214.0, 210.0, 206.0), strict=True):
        forth[index] = back[index] = look("W", index, away=right)
    filmed, passing = told_apart(forth, back)
    assert whom(filmed) == "S" * 12 + "-" * 6 + "S" * 12
    assert whom(passing) == "W" * FRAMES


def test_who_stays_is_known_beside_somebody_new_in_much_the_same():
    alike = {"L": BLUE, "M": (255, 252, 252), "R": WHITE}
    forth = beside("R" * 24 + "L" * 6, CLOSE, alike)
    back = beside("M" * 9 + "L" * 15 + "R" * 6, CLOSE, alike)
    people = named(told_apart(forth, back), CLOSE)
    assert people == {"R": list(range(30)), "L": list(range(9, 30)), "M": list(range(9))}


@pytest.mark.parametrize("unseen", [0, 3])
def test_who_is_like_one_by_colours_and_like_the_other_by_her_place_is_neither(unseen):
    """Colours do not tell R from L, nor places M from L; R was seen throughout."""
    alike = {**WORN, "L": (255, 252, 252)}
    forth = beside("R" * (FRAMES - 6) + "M" * 6, NARROW, alike)
    back = beside("M" * 12 + "L" * 6 + "-" * unseen + "M" * (6 - unseen) + "R" * 6, NARROW, alike)
    again = [*range(12), *range(18 + unseen, FRAMES)]
    people = named(told_apart(forth, back), NARROW)
    assert people == {"R": list(range(FRAMES)), "M": again, "L": list(range(12, 18))}


@pytest.mark.parametrize("swapped", [False, True])
def test_two_may_pass_one_after_the_other(swapped):
    """The track forth goes over to the second of them, and the one back to the first."""
    blue = {"worn": (WHITE, BLUE)}
    forth = track("S" * 8 + "W" * 7 + "-" * 15)
    back = track("W" * 15 + "-" * 15)
    for index in range(16, 24):  # the second one comes, where the first one was at the beginning
        forth[index] = look("W", index - 16, **blue)
        back[index] = look("S", index)
    for index in range(24, 30):
        forth[index] = back[index] = look("W", index - 16, **blue)
    filmed, *passing = told_apart(back, forth) if swapped else told_apart(forth, back)
    assert whom(filmed) == "S" * 8 + "-" * 8 + "S" * 8 + "-" * 6
    assert [list(seen) for seen in passing] == [list(range(15)), list(range(16, 30))]


@pytest.mark.parametrize(
    ("color", "slides"),
    [(WHITE, False), ((248, 255, 248), False), ((240, 255, 240), True), (BLUE, True)],
    ids=["the same", "much the same, by 4.7", "others, by 9.7", "quite others"],
)
def test_who_wears_something_else_at_the_end_of_a_long_row_is_two_people(color, slides):
    """As where a track slides over to a third one, whom the other track does not show."""
    forth, back = (
        track(one * 18 + other * 12, away=330.0) for one, other in (("S", "W"), ("W", "S"))
    )
    forth[8:18] = [look("S", index, worn=(color, PINK)) for index in range(8, 18)]
    assert (told_apart(forth, back) == []) == slides


def test_who_is_hardly_seen_or_not_in_one_track_counts_as_neither():
    forth = "SSS-sSSSSSSS" + FORTH[12:]
    back = "WWWWWwWWWWWW" + "WWwWWW" + "SSSSSSSSSS-W"
    filmed, passing = told_apart(track(forth), track(back))
    assert whom(filmed) == "SSS--SSSSSSS" + "-" * 6 + "S" * 10 + "--"
    assert whom(passing) == "WWWWW-WWWWWW" + "W" * 18


def test_where_tracks_do_not_agree_on_one_nobody_is_seen():
    forth, back = track(FORTH), track(BACK)
    aside = forth[14].sighting
    slid = aside._replace(points=aside.points + torch.tensor([0.5 * SIZE, 0.0]))
    back[14] = replace(back[14], sighting=slid)
    _, passing = told_apart(forth, back)
    assert whom(passing) == "W" * 14 + "-" + "W" * 15


@pytest.mark.parametrize("dark", [range(18, 30), range(10)])
def test_where_colours_do_not_tell_places_do(dark):
    light = {"away": 330.0}
    shade = {"away": 330.0, "worn": ((200, 190, 190), (200, 190, 190))}
    forth, back = (
        [look(who, index, **(shade if index in dark else light)) for index, who in enumerate(whom)]
        for whom in ("S" * 10 + "--" + "W" * 18, "W" * 10 + "--" + "W" * 6 + "S" * 12)
    )
    if dark[0] == 18:  # the longest run is one whose colours are known
        forth[10:12], back[10:12] = track("S" * 12)[10:], track("W" * 12, **light)[10:]
        forth[29] = back[29] = None
    people = [whom(seen).replace("-", "") for seen in told_apart(forth, back)]
    assert sorted({person[0] for person in people}) == ["S", "W"]
    for person in people:
        assert person == person[0] * len(person)
        assert len(person) >= 22


@pytest.mark.parametrize("unseen", [0, 3])
def test_far_from_each_other_places_tell_whatever_light_makes_of_colours(unseen):
    """Both turn the other's colour, as behind a sun that comes into the picture."""
    forth, back = track(FORTH, away=330.0), track(BACK, away=330.0)
    swapped = {"away": 330.0, "worn": (PINK, WHITE)}
    for index in range(18, 30):
        seen = index >= 18 + unseen
        forth[index] = look(FORTH[index], index, **swapped) if seen else None
        back[index] = look(BACK[index], index, **swapped) if seen else None
    people = told_apart(forth, back)
    stays = "S" * 12 + "-" * (6 + unseen) + "S" * (12 - unseen)
    passes = "W" * 18 + "-" * unseen + "W" * (12 - unseen)
    assert sorted(whom(seen) for seen in people) == [stays, passes]


def test_who_comes_from_far_in_colours_hardly_unlike_hers_is_somebody_new():
    """She could have come there since she was last seen."""
    forth, back = track(FORTH), track("W" * 12 + "-" * 18)
    for index in range(24, FRAMES):
        back[index] = look("W", index, away=380.0, worn=(WHITE, (238, 255, 238)))
    third = told_apart(forth, back)[2]
    assert list(third) == list(range(24, FRAMES))
    assert UNLIKE < third[24].difference(colors_worn(forth[:12])) < UNLIKE + NEARER


@pytest.mark.parametrize("reverse", [False, True])
def test_places_are_those_where_a_stretch_is_nearest_in_time(reverse):
    """Who goes away from her, in colours that do not compare, is whoever stands where she ends."""
    apart = {"away": 330.0}
    forth = [*track("W" * 12), *track("S" * 9, **apart), *track("W" * 9, **apart)]
    back = [*track("W" * 12), *track("W" * 9, **apart), *track("S" * 9, **apart)]
    for index in range(12):
        here = look("W", index, away=210.0 + 10 * index)
        forth[index] = back[index] = replace(here, colors=torch.full_like(here.colors, torch.nan))
    if reverse:
        forth, back = forth[::-1], back[::-1]
    stays, goes = sorted(told_apart(forth, back), key=len)
    assert len(stays) == 18
    assert len(goes) == FRAMES
    assert float(goes[15].centre[0]) == 330.0


@pytest.mark.parametrize("right", [None, 380.0], ids=["between", "far from all"])
def test_without_colours_and_clear_places_nobody_is_seen(right):
    forth, back = track(FORTH), track(BACK)
    for index in range(12, 18):
        here = look("W", index, away=right)
        bare = replace(here, colors=torch.full_like(here.colors, torch.nan))
        forth[index] = back[index] = bare if index > 12 else None
    filmed, passing = told_apart(forth, back)
    assert whom(filmed) == "S" * 12 + "-" * 6 + "S" * 12
    assert whom(passing) == "W" * 12 + "-" * 6 + "W" * 12


def test_places_are_told_from_one_run_to_the_next():
    shade = {"away": 330.0, "worn": ((200, 190, 190), (200, 190, 190))}
    forth = "S" * 10 + "W" * 9 + "S" * 11
    back = "W" * 13 + "S" * 9 + "W" * 8
    light = 13  # frames
    people = told_apart(
        *(
            track(whom[:light], away=330.0)
            + [look(who, index, **shade) for index, who in enumerate(whom) if index >= light]
            for whom in (forth, back)
        )
    )
    for seen in people:
        assert len(set(whom(seen)) - {"-"}) == 1
        assert len(seen) >= 24


def test_where_neither_colours_nor_places_tell_nobody_is_seen():
    forth, back = track(FORTH), track(BACK)
    for index in range(19, 30):
        shade = (200, 190, 190)
        forth[index] = look(FORTH[index], index, worn=(shade, shade))
        back[index] = look(BACK[index], index, worn=(shade, shade))
    forth[12:19] = back[12:19] = [None] * 7
    assert told_apart(forth, back) == []


@pytest.mark.parametrize(("size", "filmed"), [(40, "S"), (16, "S"), (14, "W")])
def test_who_is_much_smaller_is_not_filmed(size, filmed):
    taken, _ = told_apart(track(FORTH, size=size), track(BACK, size=size))
    assert set(whom(taken)) - {"-"} == {filmed}


@pytest.mark.parametrize(("size", "filmed"), [(40, "W"), (60, "S")])
def test_where_neither_moves_the_larger_longer_seen_one_is_filmed(size, filmed):
    how = {"size": size, "away": 330.0}
    taken, _ = told_apart(track(FORTH, **how), track(BACK, **how))
    assert set(whom(taken)) - {"-"} == {filmed}


@pytest.mark.parametrize("size", [40, 14])
def test_which_track_saw_whom_first_decides_nothing(size):
    forth, back = track(FORTH, size=size), track(BACK, size=size)
    one, other = told_apart(forth, back), told_apart(back, forth)
    assert [whom(seen) for seen in one] == [whom(seen) for seen in other]


def test_who_turns_and_wears_other_colours_behind_is_known_by_her_place():
    whole = "S" * 8 + "W" * 12 + "S" * 10, "W" * 20 + "S" * 10
    forth, back = track(whole[0]), track(whole[1])
    for index in range(20, 30):
        forth[index] = back[index] = look("S", index, worn=(BLUE, PINK))
    filmed, _ = told_apart(forth, back)
    assert whom(filmed) == "S" * 8 + "-" * 12 + "S" * 10


def test_who_stays_and_passes_through_a_shadow_is_nobody_else():
    forth, back = track("S" * 30), track("W" * 12 + "S" * 18)
    for index in range(18, 30):
        forth[index] = back[index] = look("S", index, worn=((255, 238, 238), PINK))
    assert not told_apart(forth, back)


def test_where_nobody_is_seen_for_a_while_people_may_have_changed_places():
    filmed, passing = told_apart(
        track("S" * 12 + "-" * 6 + "W" * 12), track("W" * 12 + "-" * 6 + "S" * 12)
    )
    assert whom(filmed) == "S" * 12 + "-" * 6 + "S" * 12
    assert whom(passing) == "W" * 12 + "-" * 6 + "W" * 12


@pytest.mark.parametrize("third", [12, 13])
def test_where_most_frames_show_neither_nothing_is_told(third):
    forth, back = track(FORTH), track(BACK)
    for index in range(FRAMES - third, FRAMES):  # somebody, elsewhere
        forth[index] = back[index] = look("W", index, worn=(BETWEEN, BETWEEN), away=40.0)
    assert TOLD == 0.6
    assert (told_apart(forth, back) == []) == (third > 12)


def test_people_of_whom_no_colours_are_known_are_not_told_apart(monkeypatch):
    monkeypatch.setattr(same_person, "TOO_SMALL", SIZE + 1)
    assert told_apart(track(FORTH), track(BACK)) == []


def test_two_mattes_that_overlap_are_not_two_people():
    how = {"away": STAYS + 24.0}  # a quarter of what they cover
    assert told_apart(track(FORTH, **how), track(BACK, **how)) is None


def test_tracks_without_a_matte_agree_by_their_landmarks():
    forth, back = track(FORTH), track(BACK)
    bare = forth[14].sighting
    bare = bare._replace(matte=torch.zeros_like(bare.matte))
    forth[14], back[14] = replace(forth[14], sighting=bare), replace(back[14], sighting=bare)
    _, passing = told_apart(forth, back)
    assert whom(passing) == "W" * FRAMES


@pytest.mark.parametrize(("seen", "filmed"), [(10, "S"), (9, "W")])
def test_who_is_seen_much_less_is_not_filmed(seen, filmed):
    assert 9 < LEAST_FRAMES * FRAMES <= 10
    forth = "S" * seen + "W" * (FRAMES - seen)
    taken, _ = told_apart(track(forth), track("W" * FRAMES))
    assert set(whom(taken)) - {"-"} == {filmed}


def test_in_a_crowd_whoever_wears_several_clothes_is_nobody():
    """Beside where she was somebody else is seen, farther than people move in a frame."""
    forth, back = track(FORTH), track(BACK)
    back[22:24] = [None] * 2
    for index in range(24, FRAMES):
        back[index] = look("W", index, away=STAYS + 0.45 * SIZE, worn=(BLUE, BLUE))
    assert told_apart(forth, back) == []
    back[24:] = [None] * 6
    assert told_apart(forth, back)


def test_who_was_just_seen_is_nobody_in_other_clothes_beside_her():
    forth, back = track(FORTH), track(BACK)
    for index in range(24, FRAMES):
        back[index] = look("W", index, away=STAYS + 0.45 * SIZE, worn=(BLUE, BLUE))
    filmed, passing, third = told_apart(forth, back)
    assert whom(filmed) == "S" * 12 + "-" * 6 + "S" * 6 + "-" * 6
    assert whom(passing) == "W" * FRAMES
    assert list(third) == list(range(24, FRAMES))


def test_two_who_never_meet_are_never_mixed_up():
    worn = {"worn": (WHITE, WHITE), "away": 330.0}
    assert told_apart(track("S" * FRAMES, **worn), track("W" * FRAMES, **worn)) is None


def test_the_light_on_one_person_alone_may_change_evenly():
    """She wears other colours at the end than at the beginning, and nobody else is near."""
    forth, back = track("S" * 6 + "W" * 6 + "S" * 18), track("W" * 12 + "S" * 18)
    for index in range(12, 30):
        shade = 255 - 3 * (index - 12)
        forth[index] = back[index] = look("S", index, worn=((shade, shade, shade), PINK))
    filmed, _ = told_apart(forth, back)
    assert whom(filmed) == "S" * 6 + "-" * 6 + "S" * 18


def test_in_new_colours_a_person_stays_who_she_must_be_by_her_place():
    """Who walks past goes on in a shadow; she who stays is too far off to be meant."""
    forth, back = track("S" * 12 + "W" * 18), track("W" * 12 + "S" * 6 + "-" * 12)
    for index in range(18, 30):
        forth[index] = look("W", index, worn=(WHITE, BLUE))
    people = told_apart(forth, back)
    assert len(people) == 2


def a_person(frames, size, right, step=0.0):
    made = {}
    for index in frames:
        seen = look("W", index, away=right + step * index)
        made[index] = replace(seen, size=float(size))
    return made


def test_who_is_filmed_is_neither_the_small_nor_the_brief_one():
    filmed = a_person(range(100), 40, 200.0, 0.1)
    near, tiny = a_person(range(20), 120, 20.0, 9.0), a_person(range(6), 8, 300.0)
    assert filmed_first([near, tiny, filmed])[0] is filmed
    far = a_person(range(290), 15, 300.0)  # behind her all the time, and seen longer
    assert filmed_first([far, filmed])[0] is filmed


def test_who_walks_past_two_who_stay_is_not_filmed():
    stays, beside = a_person(range(60), 40, 200.0), a_person(range(50), 40, 300.0)
    walks = a_person(range(60), 60, 20.0, 5.0)
    for people in ([stays, beside, walks], [walks, beside, stays]):
        assert filmed_first(people)[0] is stays
        assert sorted(map(id, filmed_first(people))) == sorted(map(id, people))


def test_a_track_back_is_turned_round():
    sightings = [one and one.sighting for one in track("SW-sW")]
    forth = landmarks_of(sightings, (5, HEIGHT, WIDTH), "heavy")
    turned = backward(landmarks_of(sightings[::-1], (5, HEIGHT, WIDTH), "heavy"))
    for name in ("found", "points", "visibility", "mattes", "world"):
        assert torch.equal(getattr(forth, name), getattr(turned, name))
    assert turned.model == "heavy"
    assert backward(replace(forth, world=None)).world is None
    assert isinstance(turned, Landmarks)
