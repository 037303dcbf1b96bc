"""People in black are drawn before what is as black, and mattes are compared as coverage."""

import numpy as np
import pytest

from benchmarks import same_colors
from benchmarks.same_colors import DRESSES, dark_of, filmed, waist_of

SIZE = 64


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    monkeypatch.setattr(same_colors, "SIZE", SIZE)
    monkeypatch.setattr(same_colors, "NOISE", 0.0)


def test_the_waist_is_halfway_down_and_black_that_of_the_darker_legs():
    coverage, light = np.zeros((10, 4)), np.full((10, 4, 3), 0.5)
    coverage[1:8, 1:3] = 1.0
    light[4:, 1], light[4:, 2] = 0.02, 0.4
    assert waist_of(coverage) == 4
    np.testing.assert_allclose(dark_of(light, coverage), 0.02)


@pytest.mark.parametrize("before", DRESSES)
def test_what_is_black_is_so_behind_her_too(body, before):
    frames, mattes = filmed(body, "on the spot", 3, 2, 2, before)
    assert frames.shape == (2, SIZE, SIZE, 3)
    assert (mattes > 250).any()
    lowest, highest = frames[:, -2, :6].float().mean(), frames[:, 1, :6].float().mean()
    assert (lowest < 40) == (before != "a street")
    assert (highest < 40) == (before == "all black")


def test_a_blurred_film_has_softer_mattes_than_a_sharp_one(body):
    soft = [
        int(((mattes > 20) & (mattes < 235)).sum())
        for _, mattes in (filmed(body, "on the spot", 3, 2, count, "a street") for count in (1, 5))
    ]
    assert soft[1] > soft[0]
