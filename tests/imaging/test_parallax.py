"""Tests of parallax: a camera in one place has none, one that passes something near has."""

import numpy as np
import pytest
import torch

from deblur_avatar.imaging.parallax import explained_by_a_homography, has_parallax
from tests.imaging.moving_camera import filmed, turned

K = np.array([[400.0, 0, 200], [0, 400, 150], [0, 0, 1]])


def seen_twice(way: float, *, flat: bool, outliers: float = 0.0, noise: float = 0.2):
    """Points in a room, or on its back wall alone, seen from two places some metres apart."""
    drawn = np.random.default_rng(3)
    points = drawn.uniform([-2, -1.5, 3], [2, 1.5, 8], (300, 3))
    if flat:
        points[:, 2] = 5 + 0.3 * points[:, 0]
    angle = 0.05
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    views = []
    for rotation, place in ((np.eye(3), np.zeros(3)), (turn, np.array([way, 0.02, 0]))):
        pixels = (points - place) @ rotation.T @ K.T
        views.append(pixels[:, :2] / pixels[:, 2:] + drawn.normal(0, noise, (300, 2)))
    wrong = drawn.random(300) < outliers
    views[1][wrong] = drawn.uniform(0, 400, (wrong.sum(), 2))
    return [view.astype(np.float32) for view in views]


@pytest.mark.parametrize("outliers", [0.0, 0.3])
def test_a_homography_explains_a_turn_and_a_plane_and_no_room_walked_through(outliers):
    assert explained_by_a_homography(*seen_twice(0.0, flat=False, outliers=outliers))
    assert explained_by_a_homography(*seen_twice(0.5, flat=True, outliers=outliers))
    assert not explained_by_a_homography(*seen_twice(0.5, flat=False, outliers=outliers))


def test_a_few_centimetres_beside_a_turn_are_no_parallax():
    """Where the nearest thing moves by 1 pixel against the farthest, it is noise's size."""
    assert explained_by_a_homography(*seen_twice(0.01, flat=False))


def test_matches_that_are_all_wrong_tell_nothing():
    drawn = np.random.default_rng(0)
    source, target = drawn.uniform(0, 400, (2, 40, 2)).astype(np.float32)
    assert explained_by_a_homography(source, target)


@pytest.mark.parametrize("camera", [None, turned(16, 4.0, 1.05)], ids=["pan", "roll and zoom"])
def test_a_camera_in_one_place_has_none(camera):
    frames, mattes, _ = filmed(camera=camera)
    assert not has_parallax(frames, mattes)


def test_something_near_that_passes_is_parallax():
    frames, mattes, _ = filmed(parallax=1.5, camera=turned(16, 1.0, 1.01))
    assert has_parallax(frames, mattes)


def test_the_person_who_moves_is_none():
    """She walks through the picture; her matte says that she is not background."""
    frames, mattes, _ = filmed(camera=turned(16, 1.0, 1.01))
    assert not has_parallax(frames, mattes)
    textured = frames.clone()
    for index, matte in enumerate(mattes):
        print_ = torch.randint(0, 255, (120, 160, 3), generator=torch.Generator().manual_seed(1))
        rolled = print_.roll(7 * index, 1).to(torch.uint8)
        textured[index] = torch.where(matte[..., None] > 0, rolled, frames[index])
    assert not has_parallax(textured, mattes)


def test_a_bare_background_rules_nothing_out():
    bare = torch.full((6, 60, 80, 3), 90, dtype=torch.uint8)
    assert has_parallax(bare, torch.zeros(6, 60, 80, dtype=torch.uint8))
