"""Ups are compared in the axes of the camera, which looks along +Z with +Y down."""

import math

import pytest
import torch

from benchmarks.camera_pitch import apart, pitch, row


def up(pitch_deg: float, roll_deg: float = 0.0) -> torch.Tensor:
    p, r = math.radians(pitch_deg), math.radians(roll_deg)
    return torch.tensor([math.cos(p) * math.sin(r), -math.cos(p) * math.cos(r), math.sin(p)])


def test_a_camera_that_looks_down_has_a_negative_pitch():
    assert pitch(up(-20.0)) == pytest.approx(-20, abs=1e-3)
    assert pitch(up(35.0)) == pytest.approx(35, abs=1e-3)


def test_a_row_says_how_far_off_the_told_up_and_the_picture_s_are():
    figures = row(up(-18.0), up(-23.0))
    assert figures == {
        "true_pitch_deg": -23.0, "true_roll_deg": 0.0, "told_pitch_deg": -18.0,
        "told_roll_deg": 0.0, "off_by_deg": 5.0, "picture_off_by_deg": 23.0,
    }  # fmt: skip
    rolled = row(up(-20.0), up(0.0, roll_deg=15.0))
    assert rolled["true_roll_deg"] == 15.0
    assert rolled["picture_off_by_deg"] == 15.0
    assert 20 < rolled["off_by_deg"] < 35


def test_the_same_direction_is_no_angle_apart():
    assert apart(up(-20.0), up(-20.0)) < 0.05
