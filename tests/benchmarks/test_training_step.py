"""The benchmark of a step of fitting, on a tiny scene: shared and naive steps are of one fit."""

import pytest
import torch

from benchmarks.training_step import begin, naive, observations
from deblur_avatar.training.schedule import ScheduleParams

SCHEDULE = ScheduleParams(
    warmup=40, trajectory=41, fusion=42, gaussians=200, image_height=32, levels=()
)


@pytest.fixture
def fit_and_step():
    return begin("paper", observations(SCHEDULE.image_height), SCHEDULE, "float32")


@pytest.mark.parametrize("naively", [False, True], ids=["shared", "naive"])
def test_a_step_moves_what_is_fitted(fit_and_step, naively):
    fit, step = fit_and_step
    before = [value.detach().clone() for value in fit.avatar.parameters()]
    (naive(fit) if naively else step)(0)
    moved = [
        not torch.equal(value, kept)
        for value, kept in zip(fit.avatar.parameters(), before, strict=True)
    ]
    assert any(moved)
