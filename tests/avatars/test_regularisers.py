import math

import pytest
import torch

from deblur_avatar.avatars.regularisers import elongation, excess_height, skinning_distance
from tests.randomness import seeded

pytestmark = pytest.mark.portable


def test_skinning_sums_over_joints_and_averages_over_points():
    weights = torch.tensor([[1.0, 0], [0.5, 0.5]])
    own = torch.tensor([[0.0, 1], [0.5, 0.5]])
    assert skinning_distance(weights, own).item() == pytest.approx(2 / 2)


def test_the_gradient_of_the_skinning_distance_is_that_of_its_value():
    weights = torch.rand(3, 4, generator=seeded(), dtype=torch.float64, requires_grad=True)
    own = torch.rand(3, 4, generator=seeded(1), dtype=torch.float64)
    assert skinning_distance(own, own) == 0
    assert torch.autograd.gradcheck(lambda x: skinning_distance(x, own), weights)


def test_only_what_is_much_longer_than_wide_is_held_against_it():
    flat = torch.tensor([[0.02, 0.02, 0.001], [0.02, 0.011, 0.01]]).log()  # and less than twice
    assert elongation(flat, 2.0) == 0
    needle = torch.tensor([[0.04, 0.01, 0.002]]).log()
    assert elongation(needle, 2.0).item() == pytest.approx(math.log(2))
    assert elongation(needle.flip(1), 2.0) == elongation(needle, 2.0)  # whichever axis is long
    assert elongation(needle + 3.0, 2.0).item() == pytest.approx(math.log(2), abs=1e-5)
    both = torch.cat([flat, needle])
    assert elongation(both, 2.0).item() == pytest.approx(math.log(2) / 3)


def test_the_gradient_of_elongation_is_that_of_its_value():
    scales = torch.randn(6, 3, generator=seeded(), dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: elongation(x, 2.0), scales)


def test_only_what_reaches_beyond_the_most_counts_to_either_side_of_the_surface():
    heights = torch.tensor([0.0, 0.03, -0.03, 0.05, -0.04, 0.01])
    flat = torch.zeros(6)
    assert excess_height(heights, flat, 0.03).item() == pytest.approx((0.02 + 0.01) / 6)
    assert excess_height(-heights, flat, 0.03) == excess_height(heights, flat, 0.03)
    assert excess_height(heights[:3], flat[:3], 0.03) == 0
    thick = torch.tensor([0.03, 0.0, 0.0, 0.0, 0.0, 0.05])  # one that just does not, one that does
    assert excess_height(heights, thick, 0.03).item() == pytest.approx((0.02 + 0.01 + 0.03) / 6)


def test_a_height_is_drawn_back_as_hard_however_large_it_is():
    heights = torch.tensor([0.0, 0.031, 0.3, -0.09], requires_grad=True)
    excess_height(heights, torch.zeros(4), 0.03).backward()
    assert heights.grad.tolist() == pytest.approx([0, 0.25, 0.25, -0.25])
    values = torch.randn(2, 8, generator=seeded(), dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: excess_height(x[0], x[1].abs(), 0.5), values)
