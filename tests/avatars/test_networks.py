import math

import numpy as np
import pytest
import torch
from torch import nn

from deblur_avatar.avatars.networks import (
    ConditionedMLP,
    one_blob,
    spherical_harmonics,
)

pytestmark = pytest.mark.portable


def points_in_the_cube(count=20):
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def test_a_shared_condition_is_the_same_as_a_copy_of_it_at_every_point():
    network = ConditionedMLP(3, 5, [7, 6], 4, "float32").double()
    points, condition = points_in_the_cube(), torch.randn(5).double()
    first, second = network.layers
    plain = nn.Sequential(first, nn.LeakyReLU(0.01), second, nn.LeakyReLU(0.01), network.last)
    copied = torch.cat([points, condition.expand(len(points), 5)], dim=1)
    torch.testing.assert_close(network(points, condition), plain(copied))


def test_a_network_without_condition_is_a_plain_one():
    network = ConditionedMLP(3, 0, [7], 2, "float32").double()
    points = points_in_the_cube()
    plain = nn.Sequential(network.layers[0], nn.LeakyReLU(0.01), network.last)
    torch.testing.assert_close(network(points), plain(points))


def test_gradients_reach_points_and_condition():
    network = ConditionedMLP(3, 2, [4, 4], 2, "float32").double()
    points = points_in_the_cube(3).requires_grad_()
    condition = torch.randn(2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(network, (points, condition))


def mass_in_bins(position, bins):
    """How much of the quartic bump around `position` lies in each bin, by adding it up."""
    fine = 4000
    x = (np.arange(bins * fine) + 0.5) / (bins * fine)
    apart = (x - position) * bins  # the bump's radius is one bin
    bump = np.where(np.abs(apart) < 1, 15 / 16 * (1 - apart**2) ** 2, 0) * bins
    return bump.reshape(bins, fine).sum(1) / (bins * fine)


@pytest.mark.parametrize("position", [0.0, 0.03, 0.25, 0.5, 0.62, 1.0])
def test_one_blob_is_the_mass_of_a_quartic_bump_in_each_bin(position):
    bins = 8
    encoded = one_blob(torch.full((1, 3), position, dtype=torch.float64), bins)
    expected = torch.as_tensor(mass_in_bins(position, bins)).repeat(3)
    torch.testing.assert_close(encoded[0], expected, atol=1e-7, rtol=0)


def test_no_mass_is_lost_away_from_the_border():
    bins = 16
    inside = points_in_the_cube() * (1 - 2 / bins) + 1 / bins
    total = one_blob(inside, bins).unflatten(1, (3, bins)).sum(-1)
    torch.testing.assert_close(total, torch.ones_like(total))


def test_half_the_mass_is_lost_on_the_border_and_all_of_it_far_outside():
    corner, outside = torch.zeros(1, 3).double(), torch.full((1, 3), -2.0).double()
    torch.testing.assert_close(one_blob(corner, 8).sum(), torch.tensor(1.5).double())
    assert one_blob(outside, 8).abs().max() == 0


def test_the_bump_moves_smoothly():
    points = points_in_the_cube(4).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: one_blob(x, 6), points)


def test_spherical_harmonics_are_orthonormal_and_orthogonal_to_the_mean():
    # Gauss' rule over z and equal steps around it integrate polynomials of degree 6 exactly.
    heights, weights = np.polynomial.legendre.leggauss(8)
    turns = 2 * math.pi * np.arange(16) / 16
    z, turn = (torch.as_tensor(grid) for grid in np.meshgrid(heights, turns, indexing="ij"))
    flat = (1 - z**2).sqrt()
    directions = torch.stack([flat * turn.cos(), flat * turn.sin(), z], -1).reshape(-1, 3)
    area = torch.as_tensor(weights).repeat_interleave(16) * 2 * math.pi / 16
    mean = torch.full((len(directions), 1), 0.5 / math.sqrt(math.pi)).double()
    basis = torch.cat([mean, spherical_harmonics(directions)], dim=1)
    torch.testing.assert_close((basis * area[:, None]).T @ basis, torch.eye(16).double())


def test_the_harmonics_gradient_is_that_of_differences():
    directions = (2 * points_in_the_cube(6) - 1).requires_grad_()
    assert torch.autograd.gradcheck(spherical_harmonics, directions)


def test_opposite_directions_differ_in_the_odd_degrees_only():
    directions = nn.functional.normalize(points_in_the_cube(), dim=1)
    here, there = spherical_harmonics(directions), spherical_harmonics(-directions)
    odd = torch.tensor([True] * 3 + [False] * 5 + [True] * 7)
    torch.testing.assert_close(there, torch.where(odd, -here, here))
