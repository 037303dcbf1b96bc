import math

import pytest
import torch

from deblur_avatar.motion import pose_spline as module
from deblur_avatar.motion.pose_spline import (
    knot_distance,
    knot_distance_reference,
    pose_spline,
    pose_spline_reference,
)
from tests.missing_compiler import check_a_warning_without_a_compiler

pytestmark = pytest.mark.portable

LEVER = 0.3
TIMES = (-0.5, 0.0, 0.3, 1.0, 2.75, 3.999, 4.0, 5.5)  # before the first knot, on, between, after


def drawn(knots, joints, dtype=torch.float32, spread=1.0):
    """Knots, some of which turn by nothing, by next to nothing, and by half a turn."""
    generator = torch.Generator().manual_seed(knots + joints)
    axis_angle = spread * torch.randn(knots, joints, 3, generator=generator, dtype=torch.float64)
    axis_angle[::3, 0] = 0
    axis_angle[1::3, 0] = 1e-6
    axis_angle[1, -1] = torch.tensor([math.pi, 0, 0])
    transl = torch.randn(knots, 3, generator=generator, dtype=torch.float64)
    return [value.to(dtype).requires_grad_() for value in (axis_angle, transl)]


def with_gradients(outputs, inputs):
    """Values, and gradients of a sum in which each counts differently."""
    weighed = [(o * (1.3 + torch.arange(o.numel()).reshape(o.shape)).cos()).sum() for o in outputs]
    return [*(o.detach() for o in outputs), *torch.autograd.grad(sum(weighed), inputs)]


def assert_like_its_twin(native, exact):
    for fast, slow in zip(native, exact, strict=True):
        assert fast.dtype == torch.float32
        assert fast.shape == slow.shape
        torch.testing.assert_close(fast.double(), slow, rtol=2e-5, atol=2e-6)


@pytest.mark.parametrize(("knots", "joints"), [(2, 1), (3, 2), (6, 24)])
@pytest.mark.parametrize("times", [TIMES, TIMES[2:3], ()])
def test_the_kernel_agrees_with_its_slow_twin_in_value_and_gradient(knots, joints, times):
    results = []
    for function, dtype in ((pose_spline, torch.float32), (pose_spline_reference, torch.float64)):
        inputs = drawn(knots, joints, dtype)
        at = torch.tensor(times, dtype=torch.float32).to(dtype).requires_grad_()
        results.append(with_gradients(function(*inputs, at), [*inputs, at]))
    assert_like_its_twin(*results)


def test_knots_far_from_those_that_shape_the_curve_have_no_gradient():
    axis_angle, transl = drawn(20, 3)
    quats, points = pose_spline(axis_angle, transl, torch.tensor([10.2]))
    for grad in torch.autograd.grad(quats[..., 1].sum() + points.sum(), [axis_angle, transl]):
        pulled = grad.flatten(1).abs().sum(1) > 0
        assert pulled.nonzero().flatten().tolist() == [9, 10, 11, 12]


def test_times_without_gradient_change_nothing():
    inputs, times = drawn(6, 4), torch.tensor(TIMES)
    plain = with_gradients(pose_spline(*inputs, times), inputs)
    timed = with_gradients(pose_spline(*inputs, times.clone().requires_grad_()), inputs)
    for one, other in zip(plain, timed, strict=True):
        assert torch.equal(one, other)


@pytest.mark.parametrize(("knots", "joints"), [(2, 1), (6, 24)])
def test_the_kernels_distance_agrees_with_its_slow_twin(knots, joints):
    results = []
    for function, dtype in (
        (knot_distance, torch.float32),
        (knot_distance_reference, torch.float64),
    ):
        inputs = drawn(knots, joints, dtype)
        others = tuple(value.detach() + 0.1 * value.detach().cos() for value in inputs)
        distance = function(*inputs, others, LEVER)
        results.append(with_gradients([3 * distance], inputs))
    assert_like_its_twin(*results)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])  # kernel, twin
def test_distance_is_a_mean_over_joints_and_counts_a_lever_as_a_radian(dtype):
    axis_angle = torch.zeros(2, 4, 3, dtype=dtype)
    transl = torch.zeros(2, 3, dtype=dtype)
    others = axis_angle.clone(), transl.clone()
    assert knot_distance(axis_angle, transl, others, LEVER) == 0
    axis_angle[0, 1, 2] = 0.4
    assert float(knot_distance(axis_angle, transl, others, LEVER)) == pytest.approx(0.16 / 8)
    transl[1, 0] = LEVER
    assert float(knot_distance(axis_angle, transl, others, LEVER)) == pytest.approx(0.02 + 1 / 2)


def test_the_slow_twins_have_the_gradients_of_differences():
    inputs = drawn(5, 2, torch.float64, spread=0.5)
    times = torch.tensor([0.3, 2.7], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(pose_spline_reference, (*inputs, times))


def test_it_is_the_kernel_that_float32_values_go_through(monkeypatch):
    assert module._library() is not None
    for name in ("pose_spline_reference", "knot_distance_reference"):
        monkeypatch.setattr(module, name, None)
    axis_angle, transl = drawn(4, 2)
    pose_spline(axis_angle, transl, torch.tensor([1.5]))
    knot_distance(axis_angle, transl, (axis_angle.detach(), transl.detach()), LEVER)


def test_tensors_need_not_be_contiguous():
    axis_angle, transl = drawn(6, 4)
    strided = axis_angle.transpose(0, 1).contiguous().transpose(0, 1)
    times = torch.tensor(TIMES)
    for one, other in zip(
        pose_spline(axis_angle, transl, times), pose_spline(strided, transl, times), strict=True
    ):
        assert torch.equal(one, other)


def test_what_is_not_finite_is_not_hidden():
    axis_angle, transl = drawn(4, 2)
    with torch.no_grad():
        axis_angle[1, 1, 0] = math.nan
    others = torch.zeros_like(axis_angle), torch.zeros_like(transl)
    assert not torch.isfinite(knot_distance(axis_angle, transl, others, LEVER))
    assert not torch.isfinite(pose_spline(axis_angle, transl, torch.tensor([1.0]))[0]).all()


def test_without_a_compiler_it_is_found_in_plain_torch_and_a_warning_says_why(monkeypatch):
    axis_angle, transl = drawn(4, 2)
    native = pose_spline(axis_angle, transl, torch.tensor([1.5]))
    check_a_warning_without_a_compiler(module, monkeypatch)
    monkeypatch.setattr(module, "_library", lambda: None)
    plain = pose_spline(axis_angle, transl, torch.tensor([1.5]))
    for fast, slow in zip(native, plain, strict=True):
        torch.testing.assert_close(fast, slow)
