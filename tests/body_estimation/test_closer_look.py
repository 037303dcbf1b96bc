"""A person is a white square here, found only where it fills enough of a picture."""

from contextlib import contextmanager

import pytest
import torch

from deblur_avatar.body_estimation import closer_look, same_person
from deblur_avatar.body_estimation.closer_look import GONE, follow_closely, look_closer
from deblur_avatar.body_estimation.landmarks import (
    COUNT,
    Landmarks,
    Sighting,
    landmarks_of,
)

HEIGHT, WIDTH, SIZE = 240, 400, 20
WHITE, YELLOW = torch.tensor([255, 255, 255]), torch.tensor([255, 255, 0])
SEEN = 5  # of the picture's shorter side a person must fill one part


@pytest.fixture(autouse=True)
def squares_have_colours(monkeypatch):
    monkeypatch.setattr(same_person, "TOO_SMALL", 10)


def film(places, size=SIZE, color=WHITE):
    """A square about each place (right, down); None: nobody."""
    frames = torch.zeros(len(places), HEIGHT, WIDTH, 3, dtype=torch.uint8)
    for frame, place in zip(frames, places, strict=True):
        if place is not None:
            right, down = place
            half = size // 2
            frame[max(down - half, 0) : down + half, max(right - half, 0) : right + half] = color
    return frames


def sighting_of(picture, visibility):
    """The box of all that is white."""
    white = picture[..., 0] > 200
    rows, columns = white.any(1).nonzero().flatten(), white.any(0).nonzero().flatten()
    low = torch.tensor([columns[0], rows[0]], dtype=torch.float32)
    high = torch.tensor([columns[-1], rows[-1]], dtype=torch.float32) + 1
    share = torch.linspace(0, 1, COUNT)[:, None]
    return Sighting(
        low + share * (high - low),
        torch.full((COUNT,), visibility),
        torch.ones(COUNT, 3),
        white.to(torch.uint8) * 255,
    )


def finder(visibility=0.9):
    """Sees who fills enough of a picture."""

    def find(picture):
        white = picture[..., 0] > 200
        tall = int(white.any(1).sum())
        return sighting_of(picture, visibility) if tall * SEEN >= min(white.shape) else None

    return find


def at_first(frames, found, visibility=0.9):
    """Who was found in whole frames, in some of them."""
    sightings = [
        sighting_of(frame, visibility) if index in found else None
        for index, frame in enumerate(frames)
    ]
    return landmarks_of(sightings, tuple(frames.shape[:3]), "heavy")


def middle(person, index):
    points = person.points[index]
    return ((points.amin(0) + points.amax(0)) / 2).tolist()


WALK = [(60 + 7 * index, 120 + 2 * index) for index in range(40)]


def test_a_small_person_is_followed_there_and_back():
    frames = film(WALK)
    person = follow_closely(frames, at_first(frames, range(12, 20)), finder())
    assert person.found.all()
    for index, place in enumerate(WALK):
        assert middle(person, index) == pytest.approx(place)
        right, down = place
        assert person.mattes[index, down, right] == 255
        assert int((person.mattes[index] > 0).sum()) == SIZE**2
    assert person.model == "heavy"
    assert person.world is not None
    assert (person.world == 1).all()


def test_what_was_found_in_a_run_stays_as_it_was():
    frames = film(WALK)
    first = at_first(frames, range(12, 20), visibility=0.77)
    person = follow_closely(frames, first, finder())
    assert torch.equal(person.visibility[12:20], first.visibility[12:20])
    assert (person.visibility[20:] > 0.8).all()


def test_a_mistake_far_away_is_looked_at_again():
    frames = film(WALK)
    first = at_first(frames, [3, *range(12, 20)])
    first.points[3] += torch.tensor([150.0, -60.0])
    person = follow_closely(frames, first, finder())
    assert middle(person, 3) == pytest.approx(WALK[3])


def test_a_longer_run_of_what_is_hardly_seen_is_no_person():
    frames = film(WALK)
    first = at_first(frames, range(40))
    first.points[:30] = sighting_of(film([(10, 10)])[0], 0.9).points  # in a corner, all the time
    first.visibility[:30] = 0.3
    person = follow_closely(frames, first, finder())
    assert [middle(person, index) for index in range(40)] == [pytest.approx(at) for at in WALK]


def test_who_is_unsure_is_looked_at_again_and_kept_where_windows_show_nobody():
    frames = film(WALK)
    first = at_first(frames, range(40))
    first.visibility[20:] = 0.4
    person = follow_closely(frames, first, finder())
    assert (person.visibility[20:] == 0.9).all()
    blind = follow_closely(frames, first, lambda picture: None)
    assert blind.found.all()
    assert torch.equal(blind.visibility, first.visibility)


def test_what_is_hardly_seen_in_a_window_is_not_believed():
    frames = film(WALK)
    first = at_first(frames, range(12, 20))
    assert follow_closely(frames, first, finder(0.85)).found.all()
    assert follow_closely(frames, first, finder(0.75)).found.sum() == 8


@pytest.mark.parametrize(
    ("place", "size", "same"),
    [((114, 120), SIZE, False), ((110, 120), SIZE, True), ((100, 120), 3 * SIZE, False)],
    ids=["too far", "near", "too large"],
)
def test_somebody_else_is_not_taken_for_her(place, size, same):
    """13 frames at one place, then another square."""
    frames = torch.cat([film([(100, 120)] * 13), film([place], size)])
    person = follow_closely(frames, at_first(frames, range(13)), finder())
    assert bool(person.found[13]) == same


def test_the_longer_she_was_missed_the_farther_she_may_be():
    frames = film([(100, 120)] * 10 + [None] * 8 + [(118, 120)] * 10)
    person = follow_closely(frames, at_first(frames, range(10)), finder())
    assert person.found[18:].all()
    assert not person.found[10:18].any()


def test_who_went_away_is_believed_again_where_a_run_begins():
    away = [None] * (GONE + 5)
    frames = film([(100, 120)] * 16 + away + [(300, 60)] * 10)
    back = range(16 + len(away), 26 + len(away))
    person = follow_closely(frames, at_first(frames, [*range(10), *back]), finder())
    assert person.found.nonzero().flatten().tolist() == [*range(16), *back]
    few = at_first(frames, [*range(10), *back[:4]])
    assert follow_closely(frames, few, finder()).found.sum() == 16


def test_who_has_gone_is_looked_for_no_more():
    frames = film([(100, 120)] * 10 + [None] * (GONE + 5) + [(100, 120)] * 10)
    assert follow_closely(frames, at_first(frames, range(10)), finder()).found.sum() == 10


def test_a_good_track_is_not_lost_to_one_missed_frame():
    """She is somewhere else all at once, and not seen from nearer."""
    frames = film([(60, 120)] * 12 + [None] + [(300, 60)] * 14)
    first = at_first(frames, [*range(12), *range(13, 27)])
    assert follow_closely(frames, first, finder()) is first


def test_half_of_a_person_may_be_hidden():
    def find(picture):
        found = finder(0.95)(picture)
        if found is not None:
            found.visibility[: COUNT // 3] = 0.1
        return found

    frames = film(WALK)
    assert follow_closely(frames, at_first(frames, range(12, 20)), find).found.all()


def test_the_surer_run_is_followed_and_not_the_longer_one():
    frames = film(WALK)
    first = at_first(frames, range(40), visibility=0.99)
    first.points[:22] = sighting_of(film([(10, 10)])[0], 0.9).points
    first.visibility[:22] = 0.55
    person = follow_closely(frames, first, finder())
    assert middle(person, 5) == pytest.approx(WALK[5])


def test_who_was_never_found_is_searched_for():
    frames = film(WALK)
    person = follow_closely(frames, at_first(frames, []), finder())
    assert person.found.all()
    assert middle(person, 7) == pytest.approx(WALK[7])


def test_a_glimpse_is_no_person():
    frames = film([None] * 3 + [(200, 100)] * 4 + [None] * 3)
    first = at_first(frames, [])
    assert follow_closely(frames, first, finder()) is first


def test_nobody_is_nobody():
    frames = film([None] * 6)
    first = at_first(frames, [])
    assert follow_closely(frames, first, finder()) is first


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_person_at_the_edge_is_looked_for_within_the_frame(mirrored):
    frames = film([(WIDTH - 6 * k, HEIGHT - 4) for k in range(12)])
    if mirrored:
        frames = frames.flip(1, 2)
    person = follow_closely(frames, at_first(frames, range(6, 12)), finder())
    assert person.found[1:].all()


def test_who_was_found_in_nearly_all_frames_or_by_another_detector_stays():
    frames = film(WALK)
    everywhere, nearly = at_first(frames, range(40)), at_first(frames, range(2, 40))
    assert look_closer(frames, everywhere) is everywhere
    assert look_closer(frames, nearly) is nearly
    anothers = Landmarks(
        everywhere.found.clone(), everywhere.points, everywhere.visibility, everywhere.mattes
    )
    anothers.found[:20] = False
    assert look_closer(frames, anothers) is anothers


def test_mediapipe_is_asked_anew_for_every_window(monkeypatch):
    frames = film(WALK)
    asked = []

    @contextmanager
    def pose_finder(model, *, follows):
        asked.append((model, follows))
        yield finder()

    monkeypatch.setattr(closer_look, "pose_finder", pose_finder)
    first = at_first(frames, range(12, 20))
    assert look_closer(frames, first).found.all()
    unsure = at_first(frames, range(40), visibility=0.3)
    assert (look_closer(frames, unsure).visibility > 0.5).all()
    assert asked == [("heavy", False)] * 2


def gone_over(places=WALK):
    """The track of all frames is somebody else's in six of them, a step beside her."""
    frames = film(places)
    others = [(right + 30, down) for right, down in places[25:31]]
    pictures = film(others, color=YELLOW)
    first = at_first(frames, range(40))
    for index, picture in zip(range(25, 31), pictures, strict=True):
        first.points[index] = sighting_of(picture, 0.9).points
        frames[index] = torch.maximum(frames[index], picture)
    return frames, first


def only_white(picture):
    """Sees her alone, as long as she fills enough of a picture."""
    return finder()(torch.where(picture[..., 2:] > 200, picture, 0))


def left_out(first, person):
    return (first.found & ~person.found).nonzero().flatten().tolist()


def test_who_is_dressed_otherwise_is_not_followed_and_she_is_found_beside_her():
    frames, first = gone_over()
    person = follow_closely(frames, first, only_white)
    assert person.found.all()
    assert [middle(person, index) for index in range(40)] == [pytest.approx(at) for at in WALK]


def test_who_is_dressed_otherwise_is_left_out_where_she_is_not_found(caplog):
    frames, first = gone_over()
    person = follow_closely(frames, first, finder())
    assert left_out(first, person) == list(range(25, 31))
    assert "in 6 frames somebody else" in caplog.text


def test_somebody_else_is_left_out_though_she_cannot_be_followed():
    """She is somewhere else all at once, and not seen from nearer."""
    frames = film([(60, 120)] * 12 + [None] + [(300, 60)] * 14)
    first = at_first(frames, [*range(12), *range(13, 27)])
    stranger = film([(120, 120)], color=YELLOW)
    frames[5], first.points[5] = stranger[0], sighting_of(stranger[0], 0.9).points
    assert left_out(first, follow_closely(frames, first, lambda picture: None)) == [5]


def test_where_two_were_mixed_up_she_is_taken_from_the_others_track():
    frames, first = gone_over()
    other = at_first(film(WALK), range(40), visibility=0.6)
    person = follow_closely(frames, first, lambda picture: None, other)
    assert middle(person, 27) == pytest.approx(WALK[27])
    (taken,) = (person.visibility[:, 0] == 0.6).nonzero(as_tuple=True)
    assert taken.tolist() == list(range(25, 31))


def test_who_is_hardly_seen_and_looks_odd_is_no_stranger_where_she_is(caplog):
    frames = film([(100, 120)] * 40)
    first = at_first(frames, range(40))
    first.visibility[25:31] = 0.4
    frames[25:31] = torch.where(frames[25:31] > 0, YELLOW.byte(), 0)
    assert follow_closely(frames, first, lambda picture: None).found.all()
    assert "somebody else" not in caplog.text


def test_strangers_who_are_left_out_do_not_count_against_what_windows_show():
    frames, first = gone_over([(100, 120)] * 40)
    first.found[33:36] = False

    def find(picture):
        alone = not (picture[..., 0] > picture[..., 2]).any()
        return finder()(picture) if alone else None

    person = follow_closely(frames, first, find)
    assert person.found.nonzero().flatten().tolist() == [*range(25), *range(31, 40)]


def test_whoever_comes_after_she_went_is_she_only_in_her_clothes():
    away = [None] * (GONE + 5)
    frames = film([(100, 120)] * 16 + away + [(300, 60)] * 10)
    back = range(16 + len(away), 26 + len(away))
    for index in back:
        frames[index] = torch.where(frames[index] > 0, YELLOW.byte(), frames[index])
    person = follow_closely(frames, at_first(frames, [*range(16), *back]), lambda picture: None)
    assert person.found.nonzero().flatten().tolist() == list(range(16))


def test_a_track_of_all_frames_is_looked_at_where_it_is_not_of_one_person(monkeypatch):
    @contextmanager
    def pose_finder(model, *, follows):
        yield only_white

    monkeypatch.setattr(closer_look, "pose_finder", pose_finder)
    frames, first = gone_over()
    person = look_closer(frames, first)
    assert middle(person, 27) == pytest.approx(WALK[27])
    other = at_first(film(WALK), range(25, 31), visibility=0.6)
    taken = look_closer(frames, first, other)
    assert (taken.visibility[25:31] == 0.6).all()


def recoloured(frames, indices, color=YELLOW):
    """Whoever is white in these frames is not."""
    for index in indices:
        frames[index] = torch.where(frames[index] > 0, color.byte(), frames[index])
    return frames


def test_she_is_whom_most_runs_show_and_not_the_longest():
    """Four runs are hers, apart from each other, and a longer one is somebody else's."""
    places = [(60 + 80 * (index // 11 % 2), 120) for index in range(44)] + [(300, 60)] * 15
    frames = recoloured(film(places), range(44, 59))
    first = at_first(frames, [index for index in range(59) if index % 11 != 10 or index > 43])
    person = follow_closely(frames, first, lambda picture: None)
    assert person.found[:10].all()
    assert not person.found[44:].any()
    assert left_out(first, person)[-15:] == list(range(44, 59))


def test_one_glance_in_a_window_is_no_reason_to_leave_out_a_track():
    frames = film([(60, 120)] * 40)
    first = at_first(frames, range(0, 40, 2))
    poster = film([(300, 60)], color=YELLOW)[0]
    frames[0] = torch.maximum(frames[0], poster)

    def find(picture):
        return finder(0.99)(picture) if (picture[..., 0] > picture[..., 2]).any() else None

    assert follow_closely(frames, first, find) is first


def test_who_was_followed_in_her_place_is_left_out_where_she_was_found_beside_her(caplog):
    frames = film([(60, 120)] * 14 + [None] + [(300, 60)] * 8)
    first = at_first(frames, [*range(14), *range(15, 23)])
    stranger = film([(90, 120)], color=YELLOW)[0]
    frames[2] = torch.maximum(frames[2], stranger)
    first.points[2] = sighting_of(stranger, 0.9).points
    person = follow_closely(frames, first, only_white)
    assert middle(person, 2) == pytest.approx((60, 120))
    assert "in 1 frames somebody else" in caplog.text
    assert person.found.sum() == 22


def test_mistakes_of_a_detector_are_nobody(caplog):
    frames = film(WALK)
    first = at_first(frames, range(40))
    first.points[:10] = sighting_of(film([(10, 10)])[0], 0.9).points
    first.visibility[:10] = 0.2
    first.visibility[:10, 11:27] = 0.9  # shoulders to knees
    frames[:10, :20, :20] = YELLOW.byte()
    follow_closely(frames, first, lambda picture: None)
    assert "somebody else" not in caplog.text


def test_strangers_who_are_the_most_are_not_left_out():
    frames = recoloured(film([(60, 120)] * 10 + [None] + [(300, 60)] * 60), range(11, 71))
    first = at_first(frames, [*range(10), *range(11, 71, 2)])
    assert follow_closely(frames, first, lambda picture: None) is first


@pytest.mark.parametrize("gap", [0, 1, 3])
def test_a_track_that_goes_over_to_somebody_else_after_a_gap_is_looked_at(monkeypatch, gap):
    @contextmanager
    def pose_finder(model, *, follows):
        yield lambda picture: None

    monkeypatch.setattr(closer_look, "pose_finder", pose_finder)
    others = range(40 + gap, 50 + gap)
    places = [(100, 120)] * 40 + [None] * gap + [(110, 120)] * 10 + [(100, 120)] * 60
    frames = recoloured(film(places), others)
    first = at_first(frames, [i for i, place in enumerate(places) if place is not None])
    assert left_out(first, look_closer(frames, first)) == list(others)


def test_colours_that_change_little_by_little_are_known_again():
    """She turns round while she walks, is hidden, and shows her first side again."""
    frames = film([(100, 120)] * 40 + [None] * 2 + [(112, 120)] * 8)
    for index in range(40):
        shade = torch.tensor([255, 255, 255 - 6 * index]).clamp(0)
        frames[index] = torch.where(frames[index] > 0, shade.byte(), frames[index])
    first = at_first(frames, [*range(40), *range(42, 50)])
    person = follow_closely(frames, first, lambda picture: None)
    assert person.found[42:].all()


def test_a_run_knows_all_its_colours():
    """A run goes on through a jump back to the colours of its first frames."""
    frames = film([(100, 120)] * 40 + [(112, 120)] * 4)
    for index in range(40):
        shade = torch.tensor([255, 255, 255 - 6 * index]).clamp(0)
        frames[index] = torch.where(frames[index] > 0, shade.byte(), frames[index])
    looks = same_person.looks_of(at_first(frames, range(44)), frames)
    assert [len(run) for run in closer_look._runs(looks)] == [44]


def test_of_runs_whose_colours_do_not_tell_the_surest_one_is_hers(monkeypatch):
    monkeypatch.setattr(same_person, "TOO_SMALL", 100)
    frames = film([(60, 120)] * 8 + [None] + [(300, 60)] * 20)
    looks = same_person.looks_of(at_first(frames, [*range(8), *range(9, 29)]), frames)
    short, long = closer_look._runs(looks)
    assert closer_look._surest([short, long]) is closer_look._surest([long, short]) is long


def test_who_walked_on_while_she_was_missed_is_one_person():
    places = [(100, 120)] * 20 + [None] + [(113, 120)] * 20
    frames = film(places)
    first = at_first(frames, [*range(20), *range(21, 41)])
    assert same_person.is_one(same_person.looks_of(first, frames))
    assert look_closer(frames, first) is first


def test_what_is_hardly_seen_does_not_make_a_track_two_peoples():
    frames = film([(100, 120)] * 40)
    first = at_first(frames, range(40))
    first.points[20] = sighting_of(film([(300, 60)])[0], 0.9).points
    assert not same_person.is_one(same_person.looks_of(first, frames))
    first.visibility[20] = 0.3
    assert same_person.is_one(same_person.looks_of(first, frames))
