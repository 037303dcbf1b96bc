import pytest
import torch

from deblur_avatar.avatars.gaussians import (
    gaussians_on_surface,
    neighbour_distances,
    neighbour_indices,
    sample_surface,
)
from tests.randomness import seeded

# A triangle of area 1.5 in the plane z = 0, one of area 0.5 in the plane z = 2.
VERTICES = torch.tensor([[0.0, 0, 0], [3, 0, 0], [0, 1, 0], [0, 0, 2], [1, 0, 2], [0, 1, 2]])
FACES = torch.tensor([[0, 1, 2], [3, 4, 5]])


def test_samples_lie_where_their_barycentric_coordinates_say():
    points, faces, weights = sample_surface(VERTICES, FACES, 500, seeded())
    torch.testing.assert_close((weights[..., None] * VERTICES[FACES[faces]]).sum(1), points)
    torch.testing.assert_close(weights.sum(1), torch.ones(500))
    assert (weights >= 0).all()


def test_a_surface_is_sampled_evenly():
    points, faces, _ = sample_surface(VERTICES, FACES, 20_000, seeded())
    assert (faces == 0).float().mean() == pytest.approx(0.75, abs=0.01)
    inside = points[faces == 0]
    # The part of the large triangle left of x = 1.5 is three quarters of it.
    assert (inside[:, 0] < 1.5).float().mean() == pytest.approx(0.75, abs=0.01)
    torch.testing.assert_close(inside.mean(0), torch.tensor([1.0, 1 / 3, 0]), atol=0.02, rtol=0)


def test_equal_seeds_draw_equal_points():
    here, there = (sample_surface(VERTICES, FACES, 10, seeded(1))[0] for _ in range(2))
    assert torch.equal(here, there)
    assert not torch.equal(here, sample_surface(VERTICES, FACES, 10, seeded(2))[0])


def nearest_by_looking_at_all(points, count):
    distances = torch.cdist(points, points).fill_diagonal_(torch.inf)
    return distances.sort(1).values[:, :count]


def test_neighbours_are_the_nearest_other_points():
    points = torch.randn(60, 3, generator=seeded(), dtype=torch.float64)
    expected = nearest_by_looking_at_all(points, 4)
    torch.testing.assert_close(neighbour_distances(points, 4), expected)
    assert (neighbour_indices(points, 4) != torch.arange(60)[:, None]).all()


def test_clones_in_one_place_are_each_others_neighbours_and_never_their_own():
    points = torch.randn(10, 3, generator=seeded(), dtype=torch.float64).repeat(3, 1)
    near = neighbour_indices(points, 2)
    assert (near != torch.arange(30)[:, None]).all()
    assert (near % 10 == torch.arange(30)[:, None] % 10).all()
    # More points in one place than are asked for: a point may not be among those found.
    crowd = torch.zeros(9, 3).double()
    near = neighbour_indices(crowd, 3)
    assert near.shape == (9, 3)
    assert (near != torch.arange(9)[:, None]).all()


def test_few_points_have_few_neighbours():
    assert neighbour_indices(torch.rand(3, 3), 5).shape == (3, 2)


def test_gaussians_start_grey_faint_round_and_as_wide_as_they_are_apart():
    gaussians = gaussians_on_surface(VERTICES, FACES, 200, 7, seeded())
    assert len(gaussians) == 200
    torch.testing.assert_close(gaussians.opacities, torch.full((200,), 0.1))
    torch.testing.assert_close(gaussians.quats, torch.tensor([1.0, 0, 0, 0]).expand(200, 4))
    assert gaussians.features.shape == (200, 7)
    assert gaussians.features.abs().max() == 0
    apart = nearest_by_looking_at_all(gaussians.means.double(), 3).square().mean(1).sqrt()
    expected = apart.float()[:, None].expand(200, 3)
    torch.testing.assert_close(gaussians.scales, expected)


def test_gaussians_almost_in_one_place_have_a_size_all_the_same():
    gaussians = gaussians_on_surface(1e-6 * VERTICES[:3], FACES[:1], 5, 1, seeded())
    torch.testing.assert_close(gaussians.scales, torch.full((5, 3), 1e-7**0.5))
