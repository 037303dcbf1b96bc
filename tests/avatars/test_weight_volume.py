import pytest
import torch

from deblur_avatar.avatars.avatar import canonical_vertices
from deblur_avatar.avatars.weight_volume import (
    FIRST_LATENT,
    WeightVolume,
    base_weights,
    magnitude,
    node_positions,
    smoothed,
    total_variation,
    trilinear,
    volume_box,
)
from tests.randomness import seeded

pytestmark = pytest.mark.portable

NODES = (5, 9, 7)  # along z, y and x


@pytest.fixture
def vertices(body):
    return canonical_vertices(body, torch.zeros(body.shape_dirs.shape[2]))


@pytest.fixture
def volume(body, vertices):
    return WeightVolume(vertices, body.lbs_weights, NODES, 2, 3)


def test_the_box_is_a_fifth_wider_than_the_body_and_a_quarter_as_deep(vertices):
    centre, half = volume_box(vertices)
    low, high = vertices.amin(0), vertices.amax(0)
    torch.testing.assert_close(centre, (low + high) / 2)
    larger = float((high - low)[:2].max())
    torch.testing.assert_close(half, torch.tensor([0.6, 0.6, 0.15]) * larger)
    assert ((vertices - centre).abs() <= half).all()


def test_outermost_nodes_are_corners_of_the_box_and_axes_are_z_y_x():
    centre, half = torch.tensor([1.0, 2, 3]), torch.tensor([1.0, 2, 0.5])
    nodes = node_positions(centre, half, NODES)
    assert nodes.shape == (*NODES, 3)
    torch.testing.assert_close(nodes[0, 0, 0], centre - half)
    torch.testing.assert_close(nodes[-1, -1, -1], centre + half)
    torch.testing.assert_close(nodes[-1, 0, 0], centre + half * torch.tensor([-1.0, -1, 1]))
    torch.testing.assert_close(nodes[0, 0, -1], centre + half * torch.tensor([1.0, -1, -1]))


def test_a_volume_that_has_learned_nothing_has_weights_that_sum_to_1(volume, body):
    assert volume.base.shape == (len(body.parents), *NODES)
    assert volume.base.min() >= 0
    torch.testing.assert_close(volume.base.sum(0), torch.ones(NODES))
    points = 2 * torch.randn(50, 3, generator=seeded())  # some of them outside of the box
    joints, latent = volume(points).split([len(body.parents), 3], dim=1)
    torch.testing.assert_close(joints.sum(1), torch.ones(50))
    torch.testing.assert_close(latent, torch.full((50, 3), FIRST_LATENT))


def test_a_bodys_rounded_weights_come_to_1_all_the_same(body, vertices):
    volume = WeightVolume(vertices, 0.9995 * body.lbs_weights, NODES, 2, 1)
    torch.testing.assert_close(volume.base.sum(0), torch.ones(NODES))


def test_a_node_takes_its_weights_from_the_nearest_vertices_by_their_nearness(monkeypatch):
    vertices = torch.tensor([[0.0, 0, 0], [1.0, 0, 0], [5.0, 0, 0]])
    weights = torch.eye(3)
    node = torch.tensor([0.25, 0, 0]).expand(1, 1, 1, 3)
    # Distances 0.25, 0.75 and 4.75, which counts as 1: 4, 4/3 and 1 of 19/3.
    wanted = torch.tensor([12.0, 4.0, 3.0]) / 19
    torch.testing.assert_close(base_weights(vertices, weights, node)[:, 0, 0, 0], wanted)
    monkeypatch.setattr("deblur_avatar.avatars.weight_volume.NEIGHBOURS", 2)
    wanted = torch.tensor([3.0, 1.0, 0.0]) / 4
    torch.testing.assert_close(base_weights(vertices, weights, node)[:, 0, 0, 0], wanted)


def test_a_node_on_a_vertex_has_finite_weights_that_are_all_but_its_own():
    vertices, node = torch.tensor([[0.0, 0, 0], [1.0, 0, 0]]), torch.zeros(1, 1, 1, 3)
    weights = base_weights(vertices, torch.eye(2), node)[:, 0, 0, 0]
    torch.testing.assert_close(weights, torch.tensor([1.0, 0.0]), atol=2e-4, rtol=0)


def test_a_round_of_smoothing_draws_a_node_three_tenths_towards_its_neighbours():
    volume = torch.zeros(1, 5, 5, 5)
    volume[0, 2, 2, 2] = 1
    once = smoothed(volume, 1)[0]
    torch.testing.assert_close(once[2, 2, 2], torch.tensor(0.7))
    torch.testing.assert_close(once[2, 2, 1], torch.tensor(0.3 / 6))
    torch.testing.assert_close(once[3, 2, 2], torch.tensor(0.3 / 6))
    assert once[1, 1, 2] == 0  # no neighbour of six
    torch.testing.assert_close(once.sum(), torch.tensor(1.0))
    assert volume[0, 2, 2, 2] == 1  # what came in stays


def test_smoothing_leaves_constants_and_the_outermost_nodes_as_they_are():
    torch.testing.assert_close(smoothed(torch.ones(2, 4, 5, 6), 9), torch.ones(2, 4, 5, 6))
    volume = torch.rand(1, 4, 5, 6, generator=seeded())
    after = smoothed(volume, 3)
    assert torch.equal(smoothed(volume, 0), volume)
    for face in ((0, 0), (0, -1), (1, 0), (1, -1), (2, 0), (2, -1)):
        assert torch.equal(after[0].select(*face), volume[0].select(*face))
    assert not torch.equal(after[0, 1, 1, 1], volume[0, 1, 1, 1])


def test_a_node_is_found_where_it_is(volume):
    nodes = node_positions(volume.centre, volume.half_size, NODES)
    with torch.no_grad():
        volume.corrections[4, 1, 6, 2] = 5.0
        volume.latent[2, 3, 1, 5] = 7.0
    found = volume(nodes.flatten(0, 2)).unflatten(0, NODES)
    whole = torch.cat([volume.base + volume.corrections, volume.latent])
    torch.testing.assert_close(found.permute(3, 0, 1, 2), whole, atol=1e-5, rtol=0)


def test_between_nodes_it_is_linear_and_outside_the_nearest_face_counts():
    nodes = node_positions(torch.zeros(3), torch.ones(3), NODES)
    slope = torch.tensor([1.0, -2.0, 3.0])
    volume = (nodes @ slope)[None]
    points = 2 * torch.rand(40, 3, generator=seeded()) - 1
    torch.testing.assert_close(trilinear(volume, points)[:, 0], points @ slope, atol=1e-5, rtol=0)
    outside = torch.tensor([[3.0, 0.5, -0.5]])
    torch.testing.assert_close(
        trilinear(volume, outside), trilinear(volume, outside.clamp(-1, 1)), atol=1e-6, rtol=0
    )


def test_total_variation_of_a_constant_is_0_and_of_a_ramp_its_slope():
    assert total_variation(torch.full((3, *NODES), 4.0)) == 0
    ramp = torch.arange(7.0).expand(1, *NODES)  # 1 a node along x, 0 along the others
    torch.testing.assert_close(total_variation(ramp), torch.tensor(1 / 3))
    torch.testing.assert_close(total_variation(-2 * ramp.mT.contiguous().mT), torch.tensor(2 / 3))


def test_magnitude_is_the_mean_length_of_the_nodes_channels():
    volume = torch.zeros(2, 1, 1, 2)
    volume[:, 0, 0, 1] = torch.tensor([3.0, -4.0])
    torch.testing.assert_close(magnitude(volume), torch.tensor(2.5))


def test_a_magnitude_of_zero_has_no_gradient_rather_than_none_that_is_a_number():
    volume = torch.zeros(2, *NODES, requires_grad=True)
    magnitude(volume).backward()
    assert torch.equal(volume.grad, torch.zeros_like(volume))


def test_gradients_reach_points_and_volume_in_double_precision():
    volume = torch.randn(2, 3, 4, 3, generator=seeded(), dtype=torch.float64).requires_grad_()
    points = (1.6 * torch.rand(5, 3, generator=seeded(1), dtype=torch.float64) - 0.8) * 0.97
    assert torch.autograd.gradcheck(trilinear, (volume, points.requires_grad_()))
    assert torch.autograd.gradcheck(magnitude, (volume,))
    assert torch.autograd.gradcheck(total_variation, (volume,))


def test_everything_that_is_learned_gets_a_gradient_even_at_first(volume):
    volume(0.3 * torch.randn(30, 3, generator=seeded())).square().sum().backward()
    assert volume.corrections.grad.abs().sum() > 0
    assert volume.latent.grad.abs().sum() > 0


def test_it_is_made_the_same_way_each_time(body, vertices):
    twice = [WeightVolume(vertices, body.lbs_weights, NODES, 2, 1).base for _ in range(2)]
    assert torch.equal(*twice)


def test_it_has_the_precision_of_its_vertices():
    vertices = torch.randn(200, 3, generator=seeded())  # of a body's, some are as near as others
    weights = torch.rand(200, 4, generator=seeded(1))
    single = WeightVolume(vertices, weights, NODES, 2, 1)
    double = WeightVolume(vertices.double(), weights, NODES, 2, 1)
    found = double(vertices.double())
    assert found.dtype == torch.float64
    torch.testing.assert_close(found.float(), single(vertices))


def test_only_what_is_learned_is_saved(volume):
    assert set(volume.state_dict()) == {"corrections", "latent"}
