import pytest
import torch
from scipy.interpolate import BSpline

from deblur_avatar.geometry.rotations import (
    axis_angle_to_matrix,
    axis_angle_to_quat,
    quat_multiply,
    quat_to_matrix,
)
from deblur_avatar.geometry.splines import (
    basis,
    fit_knots,
    spline_points,
    spline_quats,
)

GENERATOR = torch.Generator().manual_seed(1)
KNOTS = torch.randn(7, 3, generator=GENERATOR, dtype=torch.float64)
INSIDE = torch.tensor([1.0, 1.25, 2.0, 3.7, 4.999], dtype=torch.float64)


def test_points_agree_with_scipy_where_no_knot_is_repeated():
    # scipy's knot vector of a uniform cubic spline whose control point k is centred at time k.
    expected = BSpline(torch.arange(-2.0, 9.0).numpy(), KNOTS.numpy(), 3)(INSIDE.numpy())
    torch.testing.assert_close(spline_points(KNOTS, INSIDE), torch.tensor(expected))


def test_weights_are_a_partition_of_unity_everywhere():
    times = torch.linspace(-1, 8, 50, dtype=torch.float64)
    indices, weights = basis(times, 7)
    torch.testing.assert_close(weights.sum(1), torch.ones(50, dtype=torch.float64))
    assert indices.min() == 0
    assert indices.max() == 6
    assert weights.min() >= 0


def test_rotation_at_constant_speed_stays_at_constant_speed():
    axis = torch.tensor([0.4, -0.3, 0.2], dtype=torch.float64)
    quats = axis_angle_to_quat(torch.arange(7, dtype=torch.float64)[:, None] * axis)
    expected = axis_angle_to_matrix(INSIDE[:, None] * axis)
    torch.testing.assert_close(quat_to_matrix(spline_quats(quats, INSIDE)), expected)


def test_turning_all_knots_turns_the_whole_curve():
    quats, turn = axis_angle_to_quat(KNOTS), axis_angle_to_quat(KNOTS[:1] * 0.7)
    turned = spline_quats(quat_multiply(turn.expand_as(quats), quats), INSIDE)
    expected = quat_to_matrix(turn) @ quat_to_matrix(spline_quats(quats, INSIDE))
    torch.testing.assert_close(quat_to_matrix(turned), expected)


def test_a_curve_is_smooth_where_its_pieces_meet():
    quats = axis_angle_to_quat(KNOTS)
    step = 1e-4
    around = torch.tensor([3 - 2 * step, 3 - step, 3, 3 + step, 3 + 2 * step]).double()
    path = quat_to_matrix(spline_quats(quats, around)).flatten(1)
    before, after = path[1] - path[0], path[4] - path[3]
    assert (after - before).norm() < 1e-2 * before.norm() + 1e-6


def test_gradients_are_exact_also_where_all_knots_agree():
    still = torch.zeros(5, 3, dtype=torch.float64, requires_grad=True)
    times = torch.tensor([0.0, 1.3, 4.0], dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda k: spline_quats(axis_angle_to_quat(k), times), (still,))
    assert torch.autograd.gradcheck(lambda k: spline_points(k, times), (still,))


def test_fitting_without_smoothness_reproduces_what_a_spline_can_say():
    times = torch.linspace(0, 6, 20, dtype=torch.float64)
    values = spline_points(KNOTS, times)
    fitted = fit_knots(values, times, 7, 0.0)
    torch.testing.assert_close(spline_points(fitted, times), values, atol=1e-4, rtol=0)


def test_much_smoothness_leaves_a_straight_line():
    times = torch.linspace(0, 6, 40, dtype=torch.float64)
    values = 2 * times[:, None] + torch.randn(40, 1, generator=GENERATOR, dtype=torch.float64)
    knots = fit_knots(values, times, 7, 1e6)
    assert knots.diff(n=2, dim=0).abs().max() < 1e-3
    assert float(knots.diff(dim=0).mean()) == pytest.approx(2, abs=0.3)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_handful_of_knots_is_enough(count):
    times = torch.linspace(0, count - 1, 5, dtype=torch.float64)
    knots = fit_knots(torch.ones(5, 2, dtype=torch.float64), times, count, 0.1)
    torch.testing.assert_close(spline_points(knots, times), torch.ones(5, 2).double())
