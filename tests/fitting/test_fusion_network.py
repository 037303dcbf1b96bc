import math

import pytest
import torch

from deblur_avatar.fitting.fusion_network import FusionNetwork, position_code

BOX = (1, 2, 5, 6)  # left, top, right, bottom
SIZE = 8


@pytest.fixture
def network():
    torch.manual_seed(0)
    return FusionNetwork(
        pose_code=6, frames=3, frame_codes=4, color_features=5, hidden=[7, 7]
    ).double()


def picture(seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(SIZE, SIZE, 3, generator=generator, dtype=torch.float64)


CODE = torch.linspace(-1, 1, 6, dtype=torch.float64)


def test_the_share_is_between_none_and_all_inside_the_box_and_none_outside(network):
    share = network(picture(), CODE, 1, BOX)[..., 0]
    inside = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    inside[2:6, 1:5] = True
    assert ((share[inside] > 0) & (share[inside] < 1)).all()
    assert share[~inside].abs().max() == 0


def test_the_share_is_a_plain_network_over_everything_known_of_a_pixel(network):
    sharp = picture()
    share = network(sharp, CODE, 2, BOX)[..., 0]
    cut = sharp[2:6, 1:5].permute(2, 0, 1)[None]
    seen = torch.nn.functional.conv2d(cut, network.look.weight, network.look.bias, padding=1)[0]
    place = position_code(SIZE, SIZE, sharp)
    plain = network.network
    for row, column in ((2, 1), (4, 3), (5, 4)):
        known = torch.cat(
            [place[row, column], seen[:, row - 2, column - 1], CODE, network.frame_codes.weight[2]]
        )
        for layer in plain.layers:
            known = torch.nn.functional.leaky_relu(layer(known), 0.01)
        torch.testing.assert_close(share[row, column], plain.last(known).sigmoid()[0])


@pytest.mark.parametrize("what", ["picture", "pose", "frame"])
def test_the_share_depends_on_the_picture_the_pose_and_the_frame(network, what):
    before = network(picture(), CODE, 0, BOX)
    after = network(
        picture(1) if what == "picture" else picture(),
        CODE + 1 if what == "pose" else CODE,
        1 if what == "frame" else 0,
        BOX,
    )
    assert (before - after).abs().max() > 1e-4


def test_the_share_of_a_uniform_picture_still_depends_on_the_place(network):
    share = network(torch.zeros_like(picture()), CODE, 0, (0, 0, SIZE, SIZE))[2:6, 2:6, 0]
    assert share.std() > 1e-5


def test_both_renders_and_the_network_are_pulled(network):
    sharp, averaged = picture().requires_grad_(), picture(1).requires_grad_()
    share = network(sharp, CODE, 1, BOX)
    fused = (1 - share) * sharp + share * averaged
    fused.square().sum().backward()
    inside = averaged.grad[2:6, 1:5]
    assert (inside.abs() > 0).all()
    torch.testing.assert_close(averaged.grad.abs().sum(), inside.abs().sum())
    assert (sharp.grad.abs() > 0).all()
    assert all(value.grad is not None for value in network.parameters())
    assert network.frame_codes.weight.grad[[0, 2]].abs().max() == 0


def test_the_gradient_is_that_of_differences(network):
    small = picture()[:4, :4].clone().requires_grad_()
    code = CODE.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda x, c: network(x, c, 0, (1, 0, 4, 3)), (small, code))


def test_a_box_may_be_the_whole_picture(network):
    share = network(picture(), CODE, 0, (0, 0, SIZE, SIZE))
    assert share.shape == (SIZE, SIZE, 1)
    assert share.min() > 0


def test_the_position_code_is_sines_and_cosines_of_rows_and_columns_at_four_rates():
    height, width = 6, 9
    code = position_code(height, width, torch.zeros(1, dtype=torch.float64))
    assert code.shape == (height, width, 16)
    row, column = 2, 7
    expected = []
    for index, count in ((row, height), (column, width)):
        for wave in (math.sin, math.cos):
            for k in range(4):
                expected.append(wave(2 * math.pi * index / count * 10000 ** (-k / 4)))
    torch.testing.assert_close(code[row, column], torch.tensor(expected, dtype=torch.float64))


def test_no_two_pixels_have_one_position_code():
    code = position_code(12, 10, torch.zeros(1)).flatten(0, 1)
    apart = torch.cdist(code, code).fill_diagonal_(1.0)
    assert apart.min() > 0.1
