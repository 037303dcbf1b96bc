"""Shapes are checked where tests run: in a test's first calls, and in some of all later ones."""

import os

import pytest
import torch
from jaxtyping import TypeCheckError

from deblur_avatar.geometry.rotations import axis_angle_to_quat
from tests.conftest import ALL_CHECKED, CHECKED_EVERY

CALLS = ALL_CHECKED + 20 * CHECKED_EVERY


def refused() -> bool:
    """Whether a shape that is none is noticed."""
    try:
        axis_angle_to_quat(torch.zeros(2, 3, dtype=torch.int64))
    except TypeCheckError:
        return True
    return False


@pytest.mark.skipif(
    os.environ.get("DEBLUR_AVATAR_CHECK_SHAPES") != "1", reason="shapes are not checked here"
)
@pytest.mark.parametrize("again", [False, True])
def test_shapes_are_checked_in_the_first_calls_of_every_test_and_in_some_later_ones(again):
    noticed = [refused() for _ in range(CALLS)]
    assert all(noticed[: ALL_CHECKED // 2])
    assert 10 <= sum(noticed[ALL_CHECKED:]) <= 40
