"""She is a square that stays, in white; who passes is one in pink, and both may be in a window."""

import pytest
import torch

from deblur_avatar.body_estimation import closer_look, same_person
from deblur_avatar.body_estimation.closer_look import GONE, look_beside
from deblur_avatar.body_estimation.landmarks import COUNT, Sighting
from deblur_avatar.body_estimation.same_person import Look

HEIGHT, WIDTH, SIZE, FRAMES, PLACE = 80, 200, 20, 20, 100
WHITE, PINK, BETWEEN, GREEN = (255, 255, 255), (255, 225, 225), (255, 240, 240), (210, 255, 225)


@pytest.fixture(autouse=True)
def squares_have_colours(monkeypatch):
    monkeypatch.setattr(same_person, "TOO_SMALL", 10)


def square(frame, right, color):
    frame[30 : 30 + SIZE, right - SIZE // 2 : right + SIZE // 2] = torch.tensor(color)


def film(*people, frames=FRAMES):
    """People are a colour and where they are, by frame; later ones are in front."""
    pictures = torch.zeros(frames, HEIGHT, WIDTH, 3, dtype=torch.uint8)
    for color, places in people:
        for index, right in places.items():
            square(pictures[index], right, color)
    return pictures


def sighted(picture, visibility=0.9):
    """The box of the rightmost column's colour."""
    seen = picture[..., 0] > 200
    if not seen.any():
        return None
    last = int(seen.any(0).nonzero().max())
    color = picture[seen[:, last].nonzero()[0, 0], last]
    part = (picture == color).all(2)
    rows, columns = part.any(1).nonzero().flatten(), part.any(0).nonzero().flatten()
    low = torch.tensor([columns[0], rows[0]], dtype=torch.float32)
    high = torch.tensor([columns[-1], rows[-1]], dtype=torch.float32) + 1
    points = low + torch.linspace(0, 1, COUNT)[:, None] * (high - low)
    matte = part.to(torch.uint8) * 255
    return Sighting(points, torch.full((COUNT,), visibility), torch.ones(COUNT, 3), matte)


def looks(pictures, frames):
    return {index: Look.of(sighted(pictures[index]), pictures[index]) for index in frames}


STAYS = dict.fromkeys(range(FRAMES), PLACE)


def beside(pictures, hers, find=sighted):
    others = looks(film((PINK, {0: 40}), frames=1), [0])
    return look_beside(pictures, hers, list(others.values()), find)


@pytest.mark.parametrize("known", [range(3), range(17, 20), range(8, 12), (0, 1, 18, 19)])
def test_she_is_found_before_between_and_after(known):
    pictures = film((WHITE, STAYS))
    hers = looks(pictures, known)
    seen = beside(pictures, hers)
    assert list(seen) == list(range(FRAMES))
    assert all(seen[index] is hers[index] for index in known)
    assert all(look.centre.tolist() == [PLACE, 40] for look in seen.values())


def test_who_passes_is_not_taken_for_her():
    hidden = {index: PLACE + 2 * (index - 9) for index in range(7, 12)}  # nearly before her
    pictures = film((WHITE, STAYS), (PINK, hidden))
    seen = beside(pictures, looks(pictures, range(3)))
    assert seen.keys() == set(range(FRAMES)) - hidden.keys()


def test_she_is_found_behind_who_passes():
    """The one in front is to the left, so that the finder sees her, or what is left of her."""
    before = dict.fromkeys(range(7, 12), PLACE - 14)
    pictures = film((WHITE, STAYS), (PINK, before))
    seen = beside(pictures, looks(pictures, range(3)))
    assert list(seen) == list(range(FRAMES))


@pytest.mark.parametrize(
    ("color", "found"), [(WHITE, True), (BETWEEN, False), (PINK, False), (GREEN, False)]
)
def test_she_is_taken_only_in_colours_that_are_clearly_hers(color, found):
    places = dict.fromkeys(range(3), PLACE)
    pictures = film((WHITE, places), (color, dict.fromkeys(range(3, FRAMES), PLACE)))
    seen = beside(pictures, looks(pictures, range(3)))
    assert (len(seen) == FRAMES) == found
    assert found or len(seen) == 3


def test_colours_that_do_not_compare_are_not_hers(monkeypatch):
    pictures = film((WHITE, STAYS))
    hers = looks(pictures, range(3))
    monkeypatch.setattr(same_person, "TOO_SMALL", SIZE + 1)
    assert len(beside(pictures, hers)) == 3


def test_what_is_hardly_seen_is_not_believed():
    pictures = film((WHITE, STAYS))
    hers = looks(pictures, range(3))
    assert len(beside(pictures, hers, lambda one: sighted(one, 0.7))) == 3


def test_she_is_looked_for_beside_where_she_was_last():
    walks = {index: 40 + 6 * index for index in range(FRAMES)}
    pictures = film((WHITE, walks))
    seen = beside(pictures, looks(pictures, [0]))
    assert [look.centre[0] for look in seen.values()] == list(walks.values())


def test_who_has_been_gone_for_long_is_looked_for_no_more():
    pictures = film((WHITE, {0: PLACE, GONE + 8: PLACE}), frames=GONE + 9)
    asked = []

    def find(picture):
        asked.append(picture.shape)
        return sighted(picture)

    assert list(beside(pictures, looks(pictures, [0]), find)) == [0]
    assert len(asked) == GONE * len(closer_look.WINDOWS)
