"""A person is a white square here, found only where it fills enough of a picture."""

from contextlib import contextmanager

import pytest
import torch

from deblur_avatar.body_estimation import closer_look
from deblur_avatar.body_estimation.closer_look import GONE, follow_closely, look_closer
from deblur_avatar.body_estimation.landmarks import (
    COUNT,
    Landmarks,
    Sighting,
    landmarks_of,
)

HEIGHT, WIDTH, SIZE = 240, 400, 20
SEEN = 5  # of the picture's shorter side a person must fill one part


def film(places, size=SIZE):
    """A square about each place (right, down); None: nobody."""
    frames = torch.zeros(len(places), HEIGHT, WIDTH, 3, dtype=torch.uint8)
    for frame, place in zip(frames, places, strict=True):
        if place is not None:
            right, down = place
            half = size // 2
            frame[max(down - half, 0) : down + half, max(right - half, 0) : right + half] = 255
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
