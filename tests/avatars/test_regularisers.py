import pytest
import torch

from deblur_avatar.avatars.regularisers import skinning_distance

pytestmark = pytest.mark.portable


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def test_skinning_sums_over_joints_and_averages_over_points():
    weights = torch.tensor([[1.0, 0], [0.5, 0.5]])
    own = torch.tensor([[0.0, 1], [0.5, 0.5]])
    assert skinning_distance(weights, own).item() == pytest.approx(2 / 2)


def test_the_gradient_of_the_skinning_distance_is_that_of_its_value():
    weights = torch.rand(3, 4, generator=seeded(), dtype=torch.float64, requires_grad=True)
    own = torch.rand(3, 4, generator=seeded(1), dtype=torch.float64)
    assert skinning_distance(own, own) == 0
    assert torch.autograd.gradcheck(lambda x: skinning_distance(x, own), weights)
