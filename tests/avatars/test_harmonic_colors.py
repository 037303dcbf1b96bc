import pytest
import torch

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.harmonic_colors import (
    constant_coefficients,
    degree_at,
    further_coefficients,
    harmonic_colors,
    harmonic_features,
    seen_from,
)
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from tests.randomness import seeded

pytestmark = pytest.mark.portable

UP = torch.tensor([[0.0, 1.0, 0.0]])


def unit(count, dtype=torch.float32):
    drawn = torch.randn(count, 3, generator=seeded(), dtype=dtype)
    return torch.nn.functional.normalize(drawn, dim=1)


def step_after(iteration, scale=1.0):
    return TrainingStep(iteration, scale, None, seeded())


@pytest.mark.parametrize(("degree", "wanted"), [(0, 3), (1, 12), (2, 27), (3, 48)])
def test_there_are_three_features_a_harmonic(degree, wanted):
    assert harmonic_features(degree) == wanted


def test_features_that_are_all_zero_are_grey_from_all_sides():
    colors = harmonic_colors(torch.zeros(5, 48), unit(5), 3)
    assert torch.equal(colors, torch.full((5, 3), 0.5))


def test_constants_are_the_harmonic_of_degree_0_round_grey():
    features = torch.tensor([[1.0, -1.0, 0.0]])
    # 1 / (2 sqrt(pi)) = 0.28209.
    wanted = torch.tensor([[0.78209, 0.21791, 0.5]])
    torch.testing.assert_close(harmonic_colors(features, UP, 0), wanted, atol=1e-5, rtol=0)


def test_further_coefficients_count_a_twentieth_of_what_is_stored():
    features = torch.zeros(1, 12)
    features[0, 3:6] = torch.tensor([2.0, 4.0, -4.0])  # of the first harmonic, -sqrt(3 / 4 pi) y
    # From above y = 1: 0.5 - 0.48860 (2, 4, -4) / 20.
    wanted = torch.tensor([[0.45114, 0.40228, 0.59772]])
    torch.testing.assert_close(harmonic_colors(features, UP, 1), wanted, atol=1e-5, rtol=0)
    torch.testing.assert_close(further_coefficients(features)[0, :3], features[0, 3:6] / 20)
    assert torch.equal(constant_coefficients(features), torch.zeros(1, 3))


def test_what_is_above_the_degree_does_not_count():
    features = torch.randn(4, 48, generator=seeded())
    for degree in (0, 1, 2):
        fewer = features.clone()
        fewer[:, harmonic_features(degree) :] = 0
        at_degree = harmonic_colors(features, unit(4), degree)
        torch.testing.assert_close(at_degree, harmonic_colors(fewer, unit(4), 3))
        assert not torch.allclose(at_degree, harmonic_colors(features, unit(4), degree + 1))


def test_the_first_degree_is_odd_and_the_second_even():
    features = torch.zeros(6, 27)
    features[:, 3:12] = torch.randn(6, 9, generator=seeded())
    seen, behind = (harmonic_colors(features, side, 2) for side in (unit(6), -unit(6)))
    torch.testing.assert_close(seen - 0.5, 0.5 - behind)
    features = torch.zeros(6, 27)
    features[:, 12:] = torch.randn(6, 15, generator=seeded())
    seen, behind = (harmonic_colors(features, side, 2) for side in (unit(6), -unit(6)))
    torch.testing.assert_close(seen, behind)


def test_no_colour_is_negative_and_those_at_the_bound_get_no_gradient():
    features = torch.tensor([[-9.0, 0.0, 9.0]], requires_grad=True)
    colors = harmonic_colors(features, UP, 0)
    assert colors[0, 0] == 0
    assert colors[0, 2] > 1  # the release does not bound them above
    colors.sum().backward()
    assert features.grad[0, 0] == 0
    assert (features.grad[0, 1:] > 0).all()


@pytest.mark.parametrize(("degree", "columns"), [(1, 3), (3, 27), (4, 75), (-1, 3)])
def test_features_that_are_too_few_are_refused(degree, columns):
    with pytest.raises(ValueError, match=f"degree {degree} take .* got {columns} features"):
        harmonic_colors(torch.zeros(1, columns), UP, degree)


def test_gradients_in_double_precision():
    features = torch.randn(3, 48, generator=seeded(), dtype=torch.float64).requires_grad_()
    directions = unit(3, torch.float64).requires_grad_()
    assert harmonic_colors(features, directions, 3).dtype == torch.float64
    assert torch.autograd.gradcheck(
        lambda f, d: harmonic_colors(f, torch.nn.functional.normalize(d, dim=1), 3),
        (features, directions),
    )


def test_directions_are_those_of_the_frame_that_turns_with_its_point():
    points, centre = torch.randn(7, 3, generator=seeded()), torch.tensor([0.0, 1.0, 4.0])
    frames = axis_angle_to_matrix(torch.randn(7, 3, generator=seeded(1)))
    before = seen_from(frames, points, centre)
    torch.testing.assert_close(before.norm(dim=1), torch.ones(7))
    turn, shift = axis_angle_to_matrix(torch.tensor([0.3, 1.0, -0.2])), torch.tensor([1.0, 2, 3])
    after = seen_from(turn @ frames, points @ turn.T + shift, turn @ centre + shift)
    torch.testing.assert_close(before, after, atol=1e-5, rtol=0)


def test_in_the_worlds_frame_a_point_before_the_camera_is_seen_along_the_line_between():
    seen = seen_from(torch.eye(3)[None], torch.zeros(1, 3), torch.tensor([0.0, 0.0, 4.0]))
    torch.testing.assert_close(seen, torch.tensor([[0.0, 0.0, -1.0]]))


def test_the_degree_rises_after_each_of_its_iterations_and_is_full_without_a_step():
    up_at = (100, 300)
    degrees = [degree_at(step_after(at, scale=0.1), 2, up_at) for at in (1, 10, 11, 30, 31)]
    assert degrees == [0, 0, 1, 1, 2]
    assert degree_at(None, 2, ()) == 2
