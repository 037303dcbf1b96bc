import pytest
import torch

from deblur_avatar.avatars.regularisers import knn_smoothness, skinning_distance

pytestmark = pytest.mark.portable


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def cloud(count=20):
    points = torch.randn(count, 3, generator=seeded(), dtype=torch.float64)
    near = torch.randint(0, count, (count, 4), generator=seeded(1))
    near = torch.where(near == torch.arange(count)[:, None], (near + 1) % count, near)
    return points, near


def test_skinning_sums_over_joints_and_averages_over_points():
    weights = torch.tensor([[1.0, 0], [0.5, 0.5]])
    own = torch.tensor([[0.0, 1], [0.5, 0.5]])
    assert skinning_distance(weights, own).item() == pytest.approx(2 / 2)


def test_the_gradient_of_the_skinning_distance_is_that_of_its_value():
    weights = torch.rand(3, 4, generator=seeded(), dtype=torch.float64, requires_grad=True)
    own = torch.rand(3, 4, generator=seeded(1), dtype=torch.float64)
    assert skinning_distance(own, own) == 0
    assert torch.autograd.gradcheck(lambda x: skinning_distance(x, own), weights)


def test_what_is_the_same_everywhere_is_even_and_an_edge_costs_no_more_than_a_slope():
    row = torch.arange(10)
    near = torch.stack([(row - 1).clamp(min=0), (row + 1).clamp(max=9)], 1)
    flat, slope = torch.full((10, 1), 3.0), torch.linspace(0, 1, 10)[:, None]
    edge = (row > 4).float()[:, None]
    assert knn_smoothness(flat, near) == 0
    # Ten differences of a ninth, or one of 1, each met from both sides, among 20.
    assert knn_smoothness(slope, near).item() == pytest.approx(2 / 20)
    assert knn_smoothness(edge, near).item() == pytest.approx(2 / 20)


def test_smoothness_has_gradients_in_both_directions():
    points, near = cloud()
    values = points.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda v: knn_smoothness(v, near), values)
