"""Steps whose numbers are not finite never reach the avatar."""

import logging

import pytest
import torch

from deblur_avatar.avatars.model import AvatarModel
from deblur_avatar.errors import FittingError
from deblur_avatar.motion.frame import FrameMotion
from deblur_avatar.training import optimizers as descent_module
from deblur_avatar.training.optimizers import Descent


@pytest.fixture
def unknowns(observations, start, schedule):
    """A model, its motion, and the descent that moves them."""
    generator = torch.Generator().manual_seed(0)
    poses = observations.poses
    model = AvatarModel.create(
        start.model, observations.body, poses.betas, 5, 40, "srgb", generator
    )
    trajectory = FrameMotion(poses)
    return model, trajectory, Descent(model, trajectory, None, start, schedule)


def loss_of(model, trajectory):
    """A number that every means and every pose pulls on."""
    return model.gaussians.means.square().sum() + trajectory.axis_angle.square().sum()


def spoilt(loss, parameter, value):
    """The same loss, with a gradient of this value in one of the parameter's numbers."""
    spot = torch.zeros_like(parameter)
    spot.view(-1)[3] = value
    parameter.register_hook(lambda gradient: gradient + spot)
    return loss


def state(model, trajectory, descent):
    parts = {f"model.{k}": v.clone() for k, v in model.state_dict().items()}
    parts |= {f"motion.{k}": v.clone() for k, v in trajectory.state_dict().items()}
    return parts | descent.memory()


def same(one, other):
    return one.keys() == other.keys() and all(torch.equal(one[key], other[key]) for key in one)


LATE = 18  # an iteration at which everything moves


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e30])
@pytest.mark.parametrize("which", ["means", "axis_angle"])
def test_a_gradient_that_is_not_finite_changes_nothing_and_is_named(unknowns, which, value, caplog):
    model, trajectory, descent = unknowns
    assert descent.step(LATE, loss_of(model, trajectory))
    before = state(*unknowns)
    parameter = model.gaussians.means if which == "means" else trajectory.axis_angle
    with caplog.at_level(logging.WARNING):
        assert not descent.step(LATE, spoilt(loss_of(model, trajectory), parameter, value))
    assert same(before, state(*unknowns))
    assert descent.left_out == 1
    named = "means" if which == "means" else "motion.axis_angle"
    assert f"iteration {LATE} is left out: the gradient of {named} is not finite" in caplog.text


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_loss_that_is_not_finite_changes_nothing(unknowns, value):
    model, trajectory, descent = unknowns
    before = state(*unknowns)
    assert not descent.step(LATE, loss_of(model, trajectory) * value)
    assert same(before, state(*unknowns))


def test_the_step_after_one_that_was_left_out_is_the_step_it_would_have_been(unknowns):
    model, trajectory, descent = unknowns
    descent.step(LATE, loss_of(model, trajectory) * float("nan"))
    assert all(p.grad is None or not p.grad.any() for p in model.parameters())
    before = model.gaussians.means.detach().clone()
    assert descent.step(LATE, loss_of(model, trajectory))
    assert not torch.equal(before, model.gaussians.means)
    memory = descent.memory()
    assert memory["gaussians.means.step"].item() == 1.0
    torch.testing.assert_close(memory["gaussians.means.exp_avg"], 0.1 * 2 * before)


def test_fitting_gives_up_after_too_many_in_a_row_and_says_why(unknowns, monkeypatch):
    model, trajectory, descent = unknowns
    monkeypatch.setattr(descent_module, "MAX_IN_A_ROW", 2)
    for _ in range(2):
        assert not descent.step(LATE, loss_of(model, trajectory) * float("nan"))
    assert descent.step(LATE, loss_of(model, trajectory))
    for _ in range(2):
        assert not descent.step(LATE, loss_of(model, trajectory) * float("nan"))
    with pytest.raises(FittingError, match=r"iteration 18: the loss is not finite; 5 steps .* 3 "):
        descent.step(LATE, loss_of(model, trajectory) * float("nan"))


def test_fitting_gives_up_after_too_many_in_all(unknowns, monkeypatch):
    model, trajectory, descent = unknowns
    monkeypatch.setattr(descent_module, "MAX_IN_ALL", 3)
    for _ in range(3):
        descent.step(LATE, loss_of(model, trajectory) * float("nan"))
        descent.step(LATE, loss_of(model, trajectory))
    with pytest.raises(FittingError, match="4 steps were left out"):
        descent.step(LATE, loss_of(model, trajectory) * float("nan"))
