"""Tests of a body fit's learning rates."""

import pytest
import torch

from deblur_avatar.body_estimation.fit_rates import FINE_RATE, fit_rates


def rates() -> list[float]:
    """Of 150 coarse and 200 fine steps that begin with a rate of 1."""
    optimiser = torch.optim.SGD([torch.zeros(1, requires_grad=True)], lr=1.0)
    schedule, found = fit_rates(optimiser, 150, 200), []
    for _ in range(350):
        found += schedule.get_last_lr()
        optimiser.step()
        schedule.step()
    return found


def test_fine_steps_begin_gently():
    assert rates()[150] == pytest.approx(FINE_RATE)


def test_rates_fall_to_nothing_and_never_rise():
    found = rates()
    assert found[0] == 1
    assert found == sorted(found, reverse=True)
    assert 0 <= found[-1] < 0.001
