from contextlib import contextmanager, nullcontext
from dataclasses import replace

import pytest
import torch

from deblur_avatar.body_estimation import closer_look, person_choice, same_person
from deblur_avatar.body_estimation.landmarks import COUNT, Landmarks, Sighting, landmarks_of
from deblur_avatar.body_estimation.person_choice import detect_main_person

FRAMES, HEIGHT, WIDTH = 10, 60, 120
FRAMES_PASSED = 24  # of a film in which somebody walks past
LEFT, RIGHT = slice(10, 30), slice(80, 100)


def film(left: int, right: int, right_frames: int = FRAMES) -> torch.Tensor:
    """Two white columns of so many pixels; the right one is there in some frames only."""
    frames = torch.zeros(FRAMES, HEIGHT, WIDTH, 3, dtype=torch.uint8)
    frames[:, HEIGHT - left :, LEFT] = 255
    frames[:right_frames, HEIGHT - right :, RIGHT] = 255
    return frames


def leftmost(frames: torch.Tensor) -> Landmarks:
    """Locks on to the leftmost thing that is white."""
    found = torch.zeros(len(frames), dtype=torch.bool)
    points = torch.zeros(len(frames), COUNT, 2)
    for index, frame in enumerate(frames):
        white = frame[..., 0] > 200
        if white.any():
            column = int(white.any(0).nonzero()[0])
            part = white[:, column : column + 20]
            top = int(part.any(1).nonzero()[0])
            found[index] = True
            points[index, :, 0] = torch.linspace(column, column + 19, COUNT)
            points[index, :, 1] = torch.linspace(top, HEIGHT - 1, COUNT)
    sure = found.float()[:, None].expand(-1, COUNT)
    return Landmarks(found, points, sure, torch.zeros(frames.shape[:3], dtype=torch.uint8))


def test_one_person_is_followed():
    person, count = detect_main_person(film(40, 0), leftmost)
    assert count == 1
    assert person.found.all()


@pytest.mark.parametrize(
    ("left", "right", "frames", "followed"),
    [(40, 20, FRAMES, 10), (20, 40, FRAMES, 80), (20, 40, 4, 10)],
    ids=["the larger first", "the larger second", "the larger leaves"],
)
def test_the_larger_longer_tracked_person_is_followed_and_said(
    left, right, frames, followed, caplog: pytest.LogCaptureFixture
):
    person, count = detect_main_person(film(left, right, frames), leftmost)
    assert count == 2
    assert person.points[person.found][0, 0, 0] == followed
    assert "two people" in caplog.text


def test_nobody_is_nobody():
    person, count = detect_main_person(film(0, 0), leftmost)
    assert count == 0
    assert not person.found.any()


def test_someone_who_passes_by_is_no_second_person():
    assert detect_main_person(film(30, 50, 1), leftmost)[1] == 1


def test_who_was_missed_is_looked_at_closer(monkeypatch):
    frames = film(40, 0)

    @contextmanager
    def pose_finder(model, *, follows):
        def find(picture):
            one = leftmost(picture[None])
            if not one.found[0] or picture.shape[1] == WIDTH:
                return None
            return Sighting(one.points[0], one.visibility[0], torch.zeros(COUNT, 3), one.mattes[0])

        yield find

    def detect(frames):
        whole = leftmost(frames)
        nobody = torch.zeros(len(frames), dtype=torch.bool)
        return replace(
            whole, found=nobody, visibility=0 * whole.visibility, model="heavy",
            world=torch.zeros(len(frames), COUNT, 3),
        )  # fmt: skip

    monkeypatch.setattr(closer_look, "pose_finder", pose_finder)
    person, count = detect_main_person(frames, detect)
    assert count == 1
    assert person.found.all()


PINK = 235  # of green and blue light: who walks past wears it


def passed_by(leaves: bool) -> torch.Tensor:
    """One in white who stays, and one in pink who walks past in front of her, or stays beside."""
    frames = torch.zeros(FRAMES_PASSED, HEIGHT, WIDTH, 3, dtype=torch.uint8)
    frames[:, 10:50, 50:70] = 255
    for index, frame in enumerate(frames):
        left = 3 + 4 * index if leaves else 90
        frame[10:50, left : left + 20] = torch.tensor([255, PINK, PINK], dtype=torch.uint8)
    return frames


def keeps_to_who_is_in_front(frames: torch.Tensor) -> Landmarks:
    """Follows her in white, or who covers her, from then on; it begins with her in white."""
    sightings, follows_pink = [], False
    for frame in frames:
        red, green = frame[..., 0] > 200, frame[..., 1]
        white, pink = red & (green == 255), red & (green == PINK)
        follows_pink = (follows_pink or int(white.sum()) < 400) and bool(pink.any())
        part = pink if follows_pink else white
        if not part.any():
            sightings.append(None)
            continue
        rows, columns = part.any(1).nonzero().flatten(), part.any(0).nonzero().flatten()
        low = torch.tensor([columns[0], rows[0]], dtype=torch.float32)
        high = torch.tensor([columns[-1], rows[-1]], dtype=torch.float32) + 1
        points = low + torch.linspace(0, 1, COUNT)[:, None] * (high - low)
        sure = torch.full((COUNT,), 0.9)
        sightings.append(Sighting(points, sure, torch.ones(COUNT, 3), part.to(torch.uint8) * 255))
    return landmarks_of(sightings, tuple(frames.shape[:3]), "heavy")


@pytest.fixture
def asked_beside(monkeypatch):
    """What a look beside who passes is asked; it finds her in one frame more."""
    asked = []

    def look(frames, hers, others, find):
        asked.append((len(frames), dict(hers), list(others), find))
        missing = [index for index in range(len(frames)) if index not in hers]
        return {**hers, **dict.fromkeys(missing[:1], next(iter(hers.values())))}

    monkeypatch.setattr(person_choice, "look_beside", look)
    monkeypatch.setattr(
        person_choice, "pose_finder", lambda model, follows: nullcontext((model, follows))
    )
    return asked


def test_who_passes_in_front_is_left_out_and_said(asked_beside, monkeypatch, caplog):
    monkeypatch.setattr(same_person, "TOO_SMALL", 10)
    frames = passed_by(leaves=True)
    first = keeps_to_who_is_in_front(frames)
    assert (first.points[:, 0, 0] != 50).sum() > 8  # she was lost
    person, count = detect_main_person(frames, keeps_to_who_is_in_front)
    assert count == 2
    places = person.points[person.found, :, 0]
    assert ((places >= 50) & (places <= 70)).all()  # hers, some of it hidden
    assert int(person.found.sum()) >= 14
    assert person.model == "heavy"
    (count, hers, others, find), (_, passing, her_others, _) = asked_beside
    assert (count, find) == (FRAMES_PASSED, ("heavy", False))
    assert all(50 <= float(look.centre[0]) <= 70 for look in hers.values())
    assert others == list(passing.values())
    assert her_others == list(hers.values())
    assert min(len(hers), len(others)) >= 14
    assert int(person.found.sum()) == len(hers) + 1
    assert f"mixed up: one is followed in {len(hers) + 1} frames" in caplog.text


def test_who_is_filmed_is_told_by_what_a_look_beside_finds(asked_beside, monkeypatch):
    monkeypatch.setattr(same_person, "TOO_SMALL", 10)
    people = []
    monkeypatch.setattr(
        person_choice, "filmed_first", lambda seen: people.extend(seen) or [seen[1], seen[0]]
    )
    frames = passed_by(leaves=True)
    person, _ = detect_main_person(frames, keeps_to_who_is_in_front)
    (_, hers, _, _), (_, passing, _, _) = asked_beside
    assert [len(seen) for seen in people] == [len(hers) + 1, len(passing)]
    assert int(person.found.sum()) == len(passing) == FRAMES_PASSED


def test_two_whom_nothing_tells_apart_are_said(asked_beside, monkeypatch, caplog):
    monkeypatch.setattr(same_person, "TOO_SMALL", 1000)  # nobody's colours are known
    monkeypatch.setattr(person_choice, "look_closer", lambda frames, person: person)
    frames = passed_by(leaves=True)
    person, _ = detect_main_person(frames, keeps_to_who_is_in_front)
    assert torch.equal(person.points, keeps_to_who_is_in_front(frames).points)
    assert "may be now one and now the other" in caplog.text
    assert not asked_beside


def test_who_stays_beside_costs_a_second_look_and_changes_nothing(monkeypatch, caplog):
    monkeypatch.setattr(same_person, "TOO_SMALL", 10)
    monkeypatch.setattr(person_choice, "look_closer", lambda frames, person: person)
    frames = passed_by(leaves=False)
    asked = []

    def detect(pictures):
        asked.append(len(pictures))
        return keeps_to_who_is_in_front(pictures)

    person, _ = detect_main_person(frames, detect)
    assert person.found.all()
    assert (person.points[:, 0, 0] == 50).all()
    assert asked == [FRAMES_PASSED, FRAMES_PASSED, FRAMES_PASSED]
    assert "mixed up" not in caplog.text
    assert "may be now one" not in caplog.text
    asked.clear()
    frames[:, :, 90:] = 0
    detect_main_person(frames, detect)
    assert asked == [FRAMES_PASSED, FRAMES_PASSED]  # nobody else is seen: no track back


@pytest.mark.parametrize(("left", "right"), [(20, 40), (40, 20)])
def test_a_closer_look_is_told_of_the_other_where_she_was_found_in_all_frames(
    left, right, monkeypatch
):
    asked, made = [], []

    def detect(frames):
        made.append(leftmost(frames))
        return made[-1]

    monkeypatch.setattr(
        person_choice, "look_closer", lambda frames, *whom: asked.append(whom) or whom[0]
    )
    detect_main_person(film(left, right), detect)
    assert asked == ([(made[2], made[0])] if left < right else [(made[0],)])
