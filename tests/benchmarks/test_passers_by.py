"""Whom a matte covers is told by what each person shows of herself."""

import pytest
import torch

from benchmarks import passers_by
from benchmarks.passers_by import Stay, Walk, drawn, seen, whose
from deblur_avatar.body_estimation.landmarks import COUNT, Landmarks

SIZE = 8


def mattes(*columns):
    """Of each frame, how many columns show her, and how many somebody else, from the right."""
    made = torch.zeros(len(columns), 2, SIZE, SIZE)
    for frame, (hers, others) in zip(made, columns, strict=True):
        frame[0, :, :hers] = 1
        frame[1, :, SIZE - others :] = 1
    return made


def track(taken, found):
    return Landmarks(
        torch.tensor(found), torch.zeros(len(found), COUNT, 2), torch.ones(len(found), COUNT),
        (taken * 255).to(torch.uint8),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("hers", "others", "found", "who"),
    [
        (3, 0, True, "hers"),
        (0, 3, True, "other's"),
        (3, 3, True, "both"),
        (3, 2, True, "both"),
        (3, 1, True, "hers"),
        (1, 3, True, "other's"),
        (3, 0, False, None),
        (0, 0, True, None),
    ],
)
def test_a_matte_is_whose_it_covers_clearly_more(hers, others, found, who):
    people = mattes((hers, others))
    shares = whose(track(people.sum(1), [found]), people)
    assert shares == {name: float(name == who) for name in ("hers", "other's", "both")}


def test_shares_are_of_all_frames():
    people = mattes((3, 2), (3, 2), (3, 2), (3, 2))
    taken = torch.stack([people[0, 0], people[1, 1], people[2, 0], people[3, 0]])
    shares = whose(track(taken, [True, True, True, False]), people)
    assert shares == {"hers": 0.5, "other's": 0.25, "both": 0.0}


def test_she_is_seen_where_a_third_of_her_is():
    assert seen(mattes((6, 0), (2, 0), (1, 0), (0, 3))) == 0.5


def test_who_passes_in_front_covers_her_and_who_passes_behind_is_covered(body, monkeypatch):
    monkeypatch.setattr(passers_by, "SIZE", 48)
    areas = {}
    for name, depth in (("alone", None), ("front", 0.7), ("behind", -0.8)):
        walks = () if depth is None else (Walk(depth, 1.0, middle_s=0.0),)
        film = drawn(body, walks, seed=0, frames=1)
        assert film.pictures.shape == (1, 48, 48, 3)
        assert film.mattes.sum(1).max() <= 1 + 1e-5
        areas[name] = film.mattes.sum((0, 2, 3)).tolist()
    assert areas["front"][0] < 0.7 * areas["alone"][0]
    assert areas["behind"][0] == pytest.approx(areas["alone"][0])
    assert areas["behind"][1] < areas["front"][1]


def test_who_stays_beside_her_is_at_her_side_in_every_frame(body, monkeypatch):
    monkeypatch.setattr(passers_by, "SIZE", 48)
    film = drawn(body, (Stay(-0.9, 0.0), Stay(0.9, 0.0, None)), seed=0, frames=3)
    across = film.mattes.sum(2) @ torch.arange(48.0) / film.mattes.sum((2, 3))
    assert (across.diff(dim=1)[:, 0] < -6).all()
    assert (across[:, 2] - across[:, 0] > 6).all()
    assert not torch.equal(film.mattes[0, 1], film.mattes[2, 1])


def test_a_case_says_whose_both_tracks_are_and_what_was_warned_of(body, monkeypatch):
    film = passers_by.Film(torch.zeros(2, SIZE, SIZE, 3).to(torch.uint8), mattes((3, 3), (3, 3)))
    first, taken = (track(film.mattes[:, who], [True, True]) for who in (1, 0))

    def choose(pictures, detect):
        detect(pictures)
        passers_by.person_choice.logger.warning("2 people, whom the detector mixed up")
        return taken, 2

    monkeypatch.setattr(passers_by, "drawn", lambda *given: film)
    monkeypatch.setattr(passers_by, "detect_with_mediapipe", lambda pictures: first)
    monkeypatch.setattr(passers_by, "detect_main_person", choose)
    rows = passers_by.track_of_case(body, "two", 0, 2)
    assert (rows["first, other's"], rows["first, hers"]) == (1.0, 0.0)
    assert (rows["taken, other's"], rows["taken, hers"]) == (0.0, 1.0)
    assert (rows["seen"], rows["said"]) == (1.0, 1.0)
