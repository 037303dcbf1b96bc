from contextlib import contextmanager
from dataclasses import replace

import pytest
import torch

from deblur_avatar.body_estimation import closer_look, person_choice
from deblur_avatar.body_estimation.landmarks import COUNT, Landmarks, Sighting
from deblur_avatar.body_estimation.person_choice import detect_main_person

FRAMES, HEIGHT, WIDTH = 10, 60, 120
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
    ((person, other),) = asked
    if left < right:
        assert (person, other) == (made[2], made[0])
    else:
        assert (person, other) == (made[0], None)
