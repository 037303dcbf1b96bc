import os
import sys
import time
from collections.abc import Iterable, Iterator

import numpy as np
import pytest
import torch
from skimage.data import astronaut

from deblur_avatar import run
from deblur_avatar.body_estimation import landmarks
from deblur_avatar.body_estimation.landmarks import (
    COUNT,
    Landmarks,
    detect_with_mediapipe,
    pose_finder,
)
from deblur_avatar.body_estimation.part_landmarks import detect_parts
from deblur_avatar.body_estimation.pose_model import installed_model

NOSE, LEFT_SHOULDER, RIGHT_SHOULDER = 0, 11, 12


@pytest.fixture(scope="module")
def frames() -> torch.Tensor:
    """A portrait, an empty picture, and the portrait again."""
    portrait = np.ascontiguousarray(astronaut()[::2, ::2])
    return torch.from_numpy(np.stack([portrait, np.zeros_like(portrait), portrait]))


@pytest.fixture(scope="module")
def detected(frames) -> Landmarks:
    pytest.importorskip("mediapipe", reason="mediapipe is not installed")
    return detect_with_mediapipe(frames)


def test_a_person_is_found_where_she_is(detected: Landmarks):
    assert detected.points.shape == (3, COUNT, 2)
    nose = detected.points[0, NOSE]
    assert nose.tolist() == pytest.approx([112, 57], abs=8)
    # She faces the camera: her left is on the right of the picture.
    assert detected.points[0, LEFT_SHOULDER, 0] > detected.points[0, RIGHT_SHOULDER, 0] + 40


def test_the_matte_covers_her_and_not_the_background(detected: Landmarks):
    assert detected.mattes[0, 60, 112] > 200  # the face
    assert detected.mattes[0, 20, 20] < 50  # the wall


def test_a_frame_without_a_person_is_flagged_and_empty(detected: Landmarks):
    assert detected.found.tolist() == [True, False, True]
    assert detected.mattes[1].max() == 0
    assert detected.points[1].abs().max() == 0
    assert detected.visibility[1].max() == 0


def test_pictures_without_order_show_the_same_person_each_by_itself(detected, frames):
    with pose_finder("full", follows=False) as find:
        seen, nobody, smaller = find(frames[0]), find(frames[1]), find(frames[2, 20:])
    assert nobody is None
    assert (seen.points - detected.points[0])[NOSE].norm() < 8
    assert (smaller.points - seen.points + torch.tensor([0.0, 20.0]))[NOSE].norm() < 8
    assert seen.matte.shape == frames.shape[1:3]
    assert seen.matte[60, 112] > 200
    assert seen.world.abs().max() > 0.1


def test_the_largest_model_that_is_installed_is_taken(detected, frames, monkeypatch):
    assert detected.model == installed_model()
    monkeypatch.setattr(landmarks, "installed_model", lambda: "full")
    smaller = detect_with_mediapipe(frames[:1])
    assert smaller.model == "full"
    assert smaller.world is not None


def test_the_two_models_see_the_same_person_with_other_eyes(frames):
    pytest.importorskip("mediapipe", reason="mediapipe is not installed")
    if installed_model() != "heavy":
        pytest.skip("the heavy pose model is not installed: deblur-avatar setup, with npm")
    heavy, full = (detect_with_mediapipe(frames[:1], model) for model in ("heavy", "full"))
    assert (heavy.model, full.model) == ("heavy", "full")
    apart = (heavy.points - full.points)[0, [NOSE, LEFT_SHOULDER, RIGHT_SHOULDER]].norm(dim=-1)
    assert 0 < apart.max() < 12  # pixels


def test_the_library_is_kept_quiet_and_standard_error_comes_back(capfd: pytest.CaptureFixture[str]):
    pytest.importorskip("mediapipe", reason="mediapipe is not installed")
    detect_with_mediapipe(torch.zeros(1, 32, 32, 3, dtype=torch.uint8))
    sys.stderr.write("ours\n")
    os.write(2, b"the system's\n")
    sys.stderr.flush()
    assert capfd.readouterr().err == "ours\nthe system's\n"


def test_threads_that_begin_late_are_kept_quiet_too(frames, capfd, monkeypatch):
    pytest.importorskip("mediapipe", reason="mediapipe is not installed")

    def late(items: Iterable[int], _: str) -> Iterator[int]:
        for item in items:
            time.sleep(0.4)  # a second model is made, or the machine is busy
            yield item

    monkeypatch.setattr(run, "progress", late)
    found = detect_with_mediapipe(frames[:1])
    detect_parts(frames[:1], found.points, found.visibility)
    assert capfd.readouterr().err == ""
