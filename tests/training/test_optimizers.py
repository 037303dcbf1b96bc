"""Steps whose numbers are not finite never reach the avatar."""

import logging

import pytest
import torch

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.networks_avatar import NetworksAvatar
from deblur_avatar.errors import FittingError
from deblur_avatar.motion.frame import FrameMotion, FrameParams
from deblur_avatar.motion.trajectory import MotionRates
from deblur_avatar.training import optimizers as optimizers_module
from deblur_avatar.training.optimizers import Optimizers
from deblur_avatar.training.params import FitParams


@pytest.fixture
def unknowns(observations, recipe, schedule):
    """A model, its motion, and the optimizers that move them."""
    generator = torch.Generator().manual_seed(0)
    poses = observations.poses
    model = NetworksAvatar.create(
        recipe.model, observations.body, poses.betas, 5, 40, "srgb", generator
    )
    trajectory = FrameMotion(poses)
    moves = FrameParams(kind="frame", rates=MotionRates(poses=1e-3, transl=1e-4))
    params = FitParams(recipe=recipe, motion=moves, schedule=schedule)
    return model, trajectory, Optimizers(model, trajectory, None, params)


def loss_of(model, trajectory):
    """A number that every means and every pose pulls on."""
    return model.gaussians.means.square().sum() + trajectory.axis_angle.square().sum()


def spoilt(loss, parameter, value):
    """The same loss, with a gradient of this value in one of the parameter's numbers."""
    spot = torch.zeros_like(parameter)
    spot.view(-1)[3] = value
    parameter.register_hook(lambda gradient: gradient + spot)
    return loss


def state(model, trajectory, optimizers):
    parts = {f"model.{k}": v.clone() for k, v in model.state_dict().items()}
    parts |= {f"motion.{k}": v.clone() for k, v in trajectory.state_dict().items()}
    return parts | optimizers.memory()


def same(one, other):
    return one.keys() == other.keys() and all(torch.equal(one[key], other[key]) for key in one)


LATE = 18  # an iteration at which everything moves


@pytest.fixture
def late(recipe, schedule):
    return TrainingStep(LATE, schedule.scale, recipe.fitting, torch.Generator())


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e30])
@pytest.mark.parametrize("which", ["means", "axis_angle"])
def test_a_gradient_that_is_not_finite_changes_nothing_and_is_named(
    unknowns, which, value, caplog, late
):
    model, trajectory, optimizers = unknowns
    assert optimizers.step(late, loss_of(model, trajectory))
    before = state(*unknowns)
    parameter = model.gaussians.means if which == "means" else trajectory.axis_angle
    with caplog.at_level(logging.WARNING):
        assert not optimizers.step(late, spoilt(loss_of(model, trajectory), parameter, value))
    assert same(before, state(*unknowns))
    assert optimizers.left_out == 1
    named = "means" if which == "means" else "motion.axis_angle"
    assert f"iteration {LATE} is left out: the gradient of {named} is not finite" in caplog.text


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_loss_that_is_not_finite_changes_nothing(unknowns, value, late):
    model, trajectory, optimizers = unknowns
    before = state(*unknowns)
    assert not optimizers.step(late, loss_of(model, trajectory) * value)
    assert same(before, state(*unknowns))


def test_the_step_after_one_that_was_left_out_is_the_step_it_would_have_been(unknowns, late):
    model, trajectory, optimizers = unknowns
    optimizers.step(late, loss_of(model, trajectory) * float("nan"))
    assert all(p.grad is None or not p.grad.any() for p in model.parameters())
    before = model.gaussians.means.detach().clone()
    assert optimizers.step(late, loss_of(model, trajectory))
    assert not torch.equal(before, model.gaussians.means)
    memory = optimizers.memory()
    assert memory["gaussians.means.step"].item() == 1.0
    torch.testing.assert_close(memory["gaussians.means.exp_avg"], 0.1 * 2 * before)


def test_fitting_gives_up_after_too_many_in_a_row_and_says_why(unknowns, monkeypatch, late):
    model, trajectory, optimizers = unknowns
    monkeypatch.setattr(optimizers_module, "MAX_IN_A_ROW", 2)
    for _ in range(2):
        assert not optimizers.step(late, loss_of(model, trajectory) * float("nan"))
    assert optimizers.step(late, loss_of(model, trajectory))
    for _ in range(2):
        assert not optimizers.step(late, loss_of(model, trajectory) * float("nan"))
    with pytest.raises(FittingError, match=r"iteration 18: the loss is not finite; 5 steps .* 3 "):
        optimizers.step(late, loss_of(model, trajectory) * float("nan"))


def test_fitting_gives_up_after_too_many_in_all(unknowns, monkeypatch, late):
    model, trajectory, optimizers = unknowns
    monkeypatch.setattr(optimizers_module, "MAX_IN_ALL", 3)
    for _ in range(3):
        optimizers.step(late, loss_of(model, trajectory) * float("nan"))
        optimizers.step(late, loss_of(model, trajectory))
    with pytest.raises(FittingError, match="4 steps were left out"):
        optimizers.step(late, loss_of(model, trajectory) * float("nan"))
