import pytest
import torch

from deblur_avatar.avatars.relu_network import ReluNetwork
from tests.randomness import seeded

pytestmark = pytest.mark.portable


def network(re_entry=2, hidden=(7, 7, 7), condition=4):
    return ReluNetwork(5, condition, hidden, 3, re_entry, seeded())


def loud(own):
    """With a last layer that says something."""
    with torch.no_grad():
        own.last.weight.normal_(generator=seeded(1))
        own.last.bias.normal_(generator=seeded(2))
        for layer in own.layers:
            layer.bias.normal_(std=0.3, generator=seeded(3))
    return own


def test_it_is_what_a_plain_loop_over_points_gives():
    own = loud(network())
    points = torch.randn(6, 5, generator=seeded(4))
    condition = torch.randn(4, generator=seeded(5))
    for point, found in zip(points, own(points, condition), strict=True):
        value = torch.cat([point, condition])
        for index, layer in enumerate(own.layers):
            value = torch.cat([value, point]) if index == 2 else value
            value = (layer.weight @ value + layer.bias).clamp(min=0)
        torch.testing.assert_close(found, own.last.weight @ value + own.last.bias)


def test_a_layer_sees_the_points_again_only_where_there_is_one():
    assert [layer.in_features for layer in network().layers] == [9, 7, 12]
    assert [layer.in_features for layer in network(re_entry=3).layers] == [9, 7, 7]
    assert [layer.in_features for layer in network(re_entry=None).layers] == [9, 7, 7]


def test_it_starts_next_to_nothing_and_every_weight_can_learn():
    own = network(hidden=(64, 64, 64))
    points = torch.randn(50, 5, generator=seeded(4))
    found = own(points, torch.ones(4))
    assert 0 < found.abs().max() < 1e-3
    found.sum().backward()
    assert all(value.grad.any() for value in own.parameters())


def test_first_weights_keep_the_size_of_what_goes_through():
    own = network(hidden=(256, 256, 256, 256), re_entry=None, condition=251)
    value = torch.randn(200, 256, generator=seeded(6))
    for layer in own.layers:
        before = value.square().mean()
        value = layer(value).relu().detach()
        assert float(value.square().mean() / before) == pytest.approx(1.0, rel=0.25)


def test_the_same_generator_draws_the_same_weights():
    for one, other in zip(network().parameters(), network().parameters(), strict=True):
        assert torch.equal(one, other)
    different = ReluNetwork(5, 4, (7, 7, 7), 3, 2, seeded(9))
    assert not torch.equal(different.last.weight, network().last.weight)


def test_without_a_condition_and_without_points_it_works():
    own = loud(network(condition=0))
    points = torch.randn(6, 5, generator=seeded(4))
    torch.testing.assert_close(own(points), own(points, torch.zeros(0)))
    assert own(points[:0]).shape == (0, 3)


def test_gradients_in_double_precision():
    own = loud(network()).double()
    points = torch.randn(3, 5, generator=seeded(4), dtype=torch.float64).requires_grad_()
    condition = torch.randn(4, generator=seeded(5), dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(own, (points, condition))
