import pytest
import torch

from deblur_avatar.avatars.weight_offsets import (
    WeightOffsets,
    encoded_positions,
    nearest_weights,
)
from tests.randomness import seeded

pytestmark = pytest.mark.portable


@pytest.fixture
def offsets():
    torch.manual_seed(0)
    return WeightOffsets(5, 4, [16, 16, 8])


@pytest.fixture
def taught(offsets):
    """Offsets that are not 0."""
    with torch.no_grad():
        offsets.last.weight.normal_(generator=seeded(1))
        offsets.last.bias.normal_(generator=seeded(2))
    return offsets


def weights_of(count=7, joints=5):
    drawn = torch.rand(count, joints, generator=seeded())
    return drawn / drawn.sum(1, keepdim=True)


def test_with_offsets_of_zero_weights_are_the_nearest_vertexs(offsets):
    nearest = torch.cat([weights_of(), torch.eye(5)])
    torch.testing.assert_close(
        offsets(torch.randn(12, 3, generator=seeded()), nearest), nearest, atol=1e-6, rtol=0
    )


def test_weights_sum_to_1_and_differ_from_place_to_place(taught):
    points = torch.randn(7, 3, generator=seeded(3))
    weights = taught(points, weights_of())
    assert weights.min() >= 0
    torch.testing.assert_close(weights.sum(1), torch.ones(7))
    assert not torch.allclose(weights, taught(points.flip(0), weights_of()))


def test_offsets_count_as_factors_of_the_weights(taught, offsets):
    with torch.no_grad():
        taught.last.weight.zero_()
        taught.last.bias.copy_(torch.tensor([1.0, 0, 0, 0, 0]))
    wanted = weights_of() * torch.tensor([torch.e, 1, 1, 1, 1])
    wanted = wanted / wanted.sum(1, keepdim=True)
    found = taught(torch.zeros(7, 3), weights_of())
    torch.testing.assert_close(found, wanted, atol=1e-6, rtol=0)


def test_joints_that_a_vertex_does_not_follow_stay_out_of_reach(taught):
    weights = taught(torch.zeros(1, 3), torch.tensor([[1.0, 0, 0, 0, 0]]))
    assert weights[0, 0] > 1 - 1e-6


def test_no_gradient_flows_back_to_where_points_are_and_one_to_the_network(taught):
    points = torch.randn(7, 3, generator=seeded(), requires_grad=True)
    taught(points, weights_of()).square().sum().backward()
    assert points.grad is None
    assert all(value.grad.any() for value in taught.parameters())


def test_first_layers_wait_until_the_last_has_learned_and_then_all_do(offsets):
    offsets(torch.randn(7, 3, generator=seeded()), weights_of()).square().sum().backward()
    assert offsets.last.bias.grad.any()
    assert not offsets.again.weight.grad.any()


def test_the_release_has_68_888_numbers():
    release = WeightOffsets(24, 10, [128] * 4)
    assert sum(value.numel() for value in release.parameters()) == 68_888


def test_positions_are_seen_as_such_and_at_each_frequency():
    point = torch.tensor([[0.1, -0.2, 0.3]])
    angles = torch.cat([point, 2 * point, 4 * point], dim=1)
    wanted = torch.cat([point, angles.sin(), angles.cos()], dim=1)
    torch.testing.assert_close(encoded_positions(point, 3), wanted)
    assert encoded_positions(point, 10).shape == (1, 63)


def test_in_double_precision_it_is_double_and_has_the_gradient_it_says(taught):
    double = taught.double()
    points, nearest = torch.randn(3, 3, generator=seeded()).double(), weights_of(3).double()
    assert double(points, nearest).dtype == torch.float64
    assert torch.autograd.gradcheck(lambda w: double(points, w), (nearest.requires_grad_(),))


def test_the_nearest_vertex_alone_counts():
    vertices, weights = torch.tensor([[0.0, 0, 0], [1.0, 0, 0]]), torch.eye(2)
    points = torch.tensor([[0.4, 3, 0], [0.6, -3, 0]], requires_grad=True)
    assert torch.equal(nearest_weights(points, vertices, weights), torch.eye(2))
    double = nearest_weights(points.double(), vertices.double(), weights)
    assert double.dtype == torch.float64
