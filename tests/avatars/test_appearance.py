import math

import pytest
import torch

from deblur_avatar.avatars.appearance import ColorNetwork, random_view_rotation
from deblur_avatar.avatars.networks import spherical_harmonics

pytestmark = pytest.mark.portable


@pytest.fixture
def network():
    torch.manual_seed(0)
    network = ColorNetwork(4, deformation=2, latent=3, frames=5, hidden=[6], precision="float32")
    return network.double()


def inputs(count=7):
    generator = torch.Generator().manual_seed(0)
    features, directions, deformation = (
        torch.randn(count, size, generator=generator, dtype=torch.float64) for size in (4, 3, 2)
    )
    return features, torch.nn.functional.normalize(directions, dim=1), deformation


def test_colours_are_those_of_a_plain_network_over_everything_there_is_to_know(network):
    features, directions, deformation = inputs()
    codes = network.latents.weight[3].expand(len(features), 3)
    everything = torch.cat([features, spherical_harmonics(directions), deformation, codes], 1)
    (first,) = network.network.layers
    hidden = torch.nn.functional.leaky_relu(first(everything), 0.01)
    expected = network.network.last(hidden).sigmoid()
    colors = network(features, directions, deformation, 3)
    torch.testing.assert_close(colors, expected)
    assert ((colors > 0) & (colors < 1)).all()


def test_each_frame_has_its_own_look_and_frames_after_the_last_have_that_of_the_last(network):
    first, last, later = (network(*inputs(), frame) for frame in (0, 4, 99))
    assert (first - last).abs().max() > 1e-3
    assert torch.equal(last, later)


def test_frames_that_were_never_trained_borrow_the_nearest_trained_frames_code(network):
    before = network.latents.weight.detach().clone()
    network.fill_untrained_latents([3, 0])
    assert torch.equal(network.latents.weight, before[[0, 0, 3, 3, 3]])


def test_gradients_reach_features_directions_and_deformation(network):
    values = [value.requires_grad_() for value in inputs(2)]
    assert torch.autograd.gradcheck(lambda *given: network(*given, 1), values)


def turns(degrees, count=400):
    generator = torch.Generator().manual_seed(0)
    like = torch.zeros(1, dtype=torch.float64)
    return torch.stack([random_view_rotation(degrees, generator, like) for _ in range(count)])


def test_view_noise_is_a_rotation():
    matrices = turns(45.0, 20)
    torch.testing.assert_close(matrices @ matrices.mT, torch.eye(3).double().expand(20, 3, 3))
    torch.testing.assert_close(torch.linalg.det(matrices), torch.ones(20).double())


def test_view_noise_turns_about_y_evenly_and_about_x_and_z_by_a_quarter_turn_at_most():
    matrices = turns(60.0)
    # Entries of Rx(a) Ry(b) Rz(c); cos b > 0.
    about_y = torch.rad2deg(matrices[:, 0, 2].asin())
    about_x = torch.rad2deg(torch.atan2(-matrices[:, 1, 2], matrices[:, 2, 2]))
    about_z = torch.rad2deg(torch.atan2(-matrices[:, 0, 1], matrices[:, 0, 0]))
    assert about_y.min() >= 0
    assert about_y.max() <= 60
    assert about_y.mean().item() == pytest.approx(30, abs=3)
    for angles in (about_x, about_z):
        # 13 % of normal draws are beyond 1.5 standard deviations.
        assert (angles.abs() > 90 - 1e-6).double().mean().item() == pytest.approx(0.13, abs=0.04)
        assert angles.abs().max() <= 90 + 1e-6
        assert angles.mean().abs() < 8


def test_no_view_noise_turns_nothing():
    torch.testing.assert_close(turns(0.0, 1)[0], torch.eye(3).double())


def test_equal_generators_turn_equally():
    assert torch.equal(turns(45.0, 3), turns(45.0, 3))
    assert not math.isclose(turns(45.0, 2)[0, 0, 0].item(), turns(45.0, 2)[1, 0, 0].item())
