import math

import pytest
import torch

from deblur_avatar.fitting.fusion_network import FusionNetwork, position_code

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


def averaged(sharp):
    """Another render that differs in a block of 4 x 4, and in one channel of one pixel."""
    other = sharp.detach().clone()
    other[2:6, 1:5] = picture(1)[2:6, 1:5]
    other[0, 7, 2] += 0.25
    return other


CODE = torch.linspace(-1, 1, 6, dtype=torch.float64)
DIFFER = torch.zeros(SIZE, SIZE, dtype=torch.bool)
DIFFER[2:6, 1:5] = DIFFER[0, 7] = True


def test_the_share_is_between_none_and_all_where_renders_differ_and_none_elsewhere(network):
    share = network(picture(), averaged(picture()), CODE, 1)[..., 0]
    assert ((share[DIFFER] > 0) & (share[DIFFER] < 1)).all()
    assert share[~DIFFER].abs().max() == 0


def test_the_share_is_a_plain_network_over_everything_known_of_a_pixel(network):
    sharp = picture()
    share = network(sharp, averaged(sharp), CODE, 2)[..., 0]
    seen = torch.nn.functional.conv2d(
        sharp.permute(2, 0, 1)[None], network.look.weight, network.look.bias, padding=1
    )[0]
    place = position_code(SIZE, SIZE, sharp)
    plain = network.network
    for row, column in ((2, 1), (4, 3), (5, 4), (0, 7)):
        known = torch.cat(
            [place[row, column], seen[:, row, column], CODE, network.frame_codes.weight[2]]
        )
        for layer in plain.layers:
            known = torch.nn.functional.leaky_relu(layer(known), 0.01)
        torch.testing.assert_close(share[row, column], plain.last(known).sigmoid()[0])


@pytest.mark.parametrize("what", ["picture", "pose", "frame"])
def test_the_share_depends_on_the_picture_the_pose_and_the_frame(network, what):
    sharp = picture()
    before = network(sharp, 1 - sharp, CODE, 0)
    after = network(
        picture(1) if what == "picture" else sharp,
        1 - sharp,
        CODE + 1 if what == "pose" else CODE,
        1 if what == "frame" else 0,
    )
    assert (before - after).abs().max() > 1e-4


def test_the_share_of_a_uniform_picture_still_depends_on_the_place(network):
    black = torch.zeros_like(picture())
    share = network(black, black + 1, CODE, 0)[2:6, 2:6, 0]
    assert share.std() > 1e-5


def test_both_renders_and_the_network_are_pulled(network):
    sharp = picture().requires_grad_()
    mean = averaged(sharp).requires_grad_()
    share = network(sharp, mean, CODE, 1)
    fused = (1 - share) * sharp + share * mean
    fused.square().sum().backward()
    assert (mean.grad[DIFFER].abs().sum(-1) > 0).all()
    assert mean.grad[~DIFFER].abs().max() == 0
    assert (sharp.grad.abs() > 0).all()
    assert all(value.grad is not None for value in network.parameters())
    assert network.frame_codes.weight.grad[[0, 2]].abs().max() == 0


def test_pixels_left_out_change_neither_the_picture_nor_what_the_network_learns(network):
    results = []
    for everywhere in (False, True):
        sharp = picture().requires_grad_()
        mean = averaged(sharp).requires_grad_()
        share = network(sharp, mean + 1 if everywhere else mean, CODE, 1)
        fused = torch.lerp(sharp, mean, share)
        of_sharp, of_mean, *others = torch.autograd.grad(
            fused.square().sum(), [sharp, mean, *network.parameters()]
        )
        results.append([fused, of_sharp + of_mean, *others])
    for some, every in zip(*results, strict=True):
        torch.testing.assert_close(some, every)


def test_renders_that_agree_everywhere_leave_nothing_to_choose(network):
    sharp = picture().requires_grad_()
    share = network(sharp, sharp.detach().clone(), CODE, 0)
    assert share.shape == (SIZE, SIZE, 1)
    assert share.abs().max() == 0
    assert not share.requires_grad


@pytest.mark.parametrize("size", [(4, 4), (1, 5), (5, 1)])
def test_the_gradient_is_that_of_differences(network, size):
    sharp = picture()[: size[0], : size[1]].clone()
    other = sharp + 1
    other[0, 0] = sharp[0, 0] + torch.tensor([0.0, 0.0, 3.0])
    small, code = sharp.requires_grad_(), CODE.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda x, c: network(x, other.detach(), c, 0), (small, code))


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
