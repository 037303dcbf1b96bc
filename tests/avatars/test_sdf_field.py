import math

import pytest
import torch

from deblur_avatar.avatars.sdf_field import SdfField, density, eikonal
from tests.randomness import seeded

pytestmark = pytest.mark.portable


@pytest.fixture
def corners():
    return torch.tensor([[-1.0, -2.0, 0.0], [1.0, 2.0, 0.5]])


@pytest.fixture
def own(corners):
    return SdfField(corners, 5, (8, 7), 30.0, seeded())


def loud(own):
    with torch.no_grad():
        own.modulation.weight.normal_(std=0.3, generator=seeded(1))
        own.modulation.bias.normal_(std=0.1, generator=seeded(2))
    return own


def test_it_is_what_a_plain_loop_over_points_gives(own):
    loud(own)
    condition = torch.randn(5, generator=seeded(3))
    points = torch.randn(6, 3, generator=seeded(4))
    found, features = own(points, own.modulated(condition))
    seen = own.seen.weight @ condition
    seen = torch.where(seen > 0, seen, 0.2 * seen)
    numbers = own.modulation.weight @ seen + own.modulation.bias
    stretches, shifts = numbers[:15].split([8, 7]), numbers[15:].split([8, 7])
    half = 2.0 * 1.1
    for point, distance, feature in zip(points, found, features, strict=True):
        value = (point - torch.tensor([0.0, 0.0, 0.25])) / half
        for layer, more, added in zip(own.layers, stretches, shifts, strict=False):
            value = (30 * ((1 + more) * (layer.weight @ value + layer.bias) + added)).sin()
        torch.testing.assert_close(feature, value, atol=1e-4, rtol=0)
        wanted = half * (own.layers[-1].weight @ value + own.layers[-1].bias)[0]
        torch.testing.assert_close(distance, wanted, atol=1e-4, rtol=0)


def test_at_first_no_condition_has_a_say(own):
    points = torch.randn(6, 3, generator=seeded(4))
    found = [own(points, own.modulated(torch.full((5,), value)))[0] for value in (0.0, 3.0)]
    assert torch.equal(*found)
    loud(own)
    found = [own(points, own.modulated(torch.full((5,), value)))[0] for value in (0.0, 3.0)]
    assert not torch.allclose(*found, atol=1e-3)


def test_first_weights_are_sirens_and_from_the_generator(corners):
    torch.manual_seed(7)
    own = SdfField(corners, 5, (64, 64), 30.0, seeded())
    first, second, last = (layer.weight.detach() for layer in own.layers)
    assert first.abs().max() == pytest.approx(1 / 3, rel=0.03)
    for weight in (second, last):
        assert weight.abs().max() <= math.sqrt(6 / 64) / 30
    assert second.abs().max() == pytest.approx(math.sqrt(6 / 64) / 30, rel=0.03)
    again = SdfField(corners, 5, (64, 64), 30.0, seeded())
    for one, other in zip(own.parameters(), again.parameters(), strict=True):
        assert torch.equal(one, other)


def test_normals_are_the_distances_gradients_and_have_some_themselves(own):
    own, condition = loud(own).double(), torch.randn(5, generator=seeded(3)).double()
    points = torch.randn(4, 3, generator=seeded(4)).double().requires_grad_()

    def distance(values):
        return own(values, own.modulated(condition))[0]

    def normal(values):
        return own.normals(values, own.modulated(condition))[2]

    found, _, gradients = own.normals(points, own.modulated(condition))
    torch.testing.assert_close(found, distance(points))
    torch.testing.assert_close(gradients, torch.autograd.grad(distance(points).sum(), points)[0])
    assert torch.autograd.gradcheck(normal, (points,))
    gradients.square().sum().backward()
    assert own.layers[0].weight.grad.any()


def test_normals_without_gradients_are_the_same_and_carry_none(own):
    points = torch.randn(4, 3, generator=seeded(4))
    modulation = loud(own).modulated(torch.zeros(5))
    wanted = own.normals(points, modulation)
    with torch.no_grad():
        found = own.normals(points, modulation)
    for one, other in zip(found, wanted, strict=True):
        torch.testing.assert_close(one, other.detach())
        assert not one.requires_grad


def test_densities_are_laplaces_distribution():
    width = torch.tensor(0.02)
    apart = torch.tensor([-9.0, -0.02, 0.0, 0.02, 9.0])
    found = density(apart, width)
    wanted = torch.tensor([50.0, 50 - 25 / math.e, 25.0, 25 / math.e, 0.0])
    torch.testing.assert_close(found, wanted, atol=1e-4, rtol=0)


def test_densities_have_gradients_however_far_and_of_the_width():
    apart = torch.tensor([-50.0, -0.01, 0.01, 50.0], requires_grad=True)
    width = torch.tensor(1e-3, requires_grad=True)
    density(apart, width).sum().backward()
    assert torch.isfinite(apart.grad).all()
    assert width.grad.isfinite()
    assert width.grad != 0
    places = torch.tensor([-0.03, -0.01, 0.01, 0.03], dtype=torch.double, requires_grad=True)
    wide = torch.tensor(0.02, dtype=torch.double, requires_grad=True)
    assert torch.autograd.gradcheck(density, (places, wide))


def test_distances_grow_by_a_metre_a_metre_or_cost():
    along = torch.nn.functional.normalize(torch.randn(5, 3, generator=seeded()), dim=1)
    assert float(eikonal(along)) == pytest.approx(0.0, abs=1e-6)
    assert float(eikonal(3 * along)) == pytest.approx(2.0)
    nothing = torch.zeros(1, 3, requires_grad=True)
    cost = eikonal(nothing)
    cost.backward()
    assert cost.item() == pytest.approx(1.0)
    assert torch.isfinite(nothing.grad).all()
