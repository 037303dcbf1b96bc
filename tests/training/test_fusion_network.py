import math

import pytest
import torch

from deblur_avatar.training.fusion_network import (
    TOGETHER,
    FusionNetwork,
    position_code,
)

pytestmark = pytest.mark.portable

SIZE = 8


@pytest.fixture
def network():
    torch.manual_seed(0)
    return FusionNetwork(
        pose_code=6,
        frames=3,
        frame_codes=4,
        color_features=5,
        hidden=[7, 7],
        precision="bfloat16",
    ).double()


def picture(seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(SIZE, SIZE, 3, generator=generator, dtype=torch.float64)


CODE = torch.linspace(-1, 1, 6, dtype=torch.float64)
COVERED = torch.zeros(SIZE, SIZE, dtype=torch.bool)
COVERED[2:6, 1:5] = COVERED[0, 7] = True
EVERYWHERE = torch.ones(SIZE, SIZE, dtype=torch.bool)


def test_the_share_is_between_none_and_all_where_anything_is_shown_and_none_elsewhere(network):
    share = network(picture(), COVERED, CODE, 1)[..., 0]
    assert ((share[COVERED] > 0) & (share[COVERED] < 1)).all()
    assert share[~COVERED].abs().max() == 0


def test_the_share_is_a_plain_network_over_everything_known_of_a_pixel(network):
    sharp = picture()
    share = network(sharp, COVERED, CODE, 2)[..., 0]
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
    before = network(picture(), COVERED, CODE, 0)
    after = network(
        picture(1) if what == "picture" else picture(),
        COVERED,
        CODE + 1 if what == "pose" else CODE,
        1 if what == "frame" else 0,
    )
    assert (before - after).abs().max() > 1e-4


def test_the_share_of_a_uniform_picture_still_depends_on_the_place(network):
    share = network(torch.zeros_like(picture()), EVERYWHERE, CODE, 0)[2:6, 2:6, 0]
    assert share.std() > 1e-5


def test_both_renders_and_the_network_are_pulled(network):
    sharp, mean = picture().requires_grad_(), picture(1).requires_grad_()
    share = network(sharp, COVERED, CODE, 1)
    fused = (1 - share) * sharp + share * mean
    fused.square().sum().backward()
    assert (mean.grad[COVERED].abs() > 0).all()
    assert mean.grad[~COVERED].abs().max() == 0
    assert (sharp.grad.abs() > 0).all()
    assert all(value.grad is not None for value in network.parameters())
    assert network.frame_codes.weight.grad[[0, 2]].abs().max() == 0


@pytest.mark.parametrize("detached", [False, True])
def test_leaving_out_what_nothing_covers_changes_no_value_and_no_gradient(network, detached):
    """Two renders are the same background there, and do not depend on anything."""
    results = []
    for asked in (COVERED, EVERYWHERE):
        raw = [picture().requires_grad_(), picture(1).requires_grad_()]
        raw[1].data[3, 2] = raw[0].data[3, 2]  # covered, and alike by chance
        sharp, mean = (COVERED[..., None] * value for value in raw)
        share = network(sharp, asked, CODE, 1)
        fused = torch.lerp(sharp, mean.detach() if detached else mean, share)
        unknowns = [raw[0], *([] if detached else raw[1:]), *network.parameters()]
        results.append([fused, *torch.autograd.grad(fused.square().sum(), unknowns)])
    for some, every in zip(*results, strict=True):
        torch.testing.assert_close(some, every)


def test_renders_that_show_nothing_leave_nothing_to_choose(network):
    share = network(picture().requires_grad_(), ~EVERYWHERE, CODE, 0)
    assert share.shape == (SIZE, SIZE, 1)
    assert share.abs().max() == 0
    assert not share.requires_grad


@pytest.mark.parametrize("count", [1, TOGETHER - 1, TOGETHER, TOGETHER + 1])
def test_rows_that_fill_up_answer_for_nobody(network, count):
    """In single precision, too, in which products may be of halves."""
    sharp = torch.rand(24, 30, 3, generator=torch.Generator().manual_seed(0))
    covered = torch.zeros(24 * 30, dtype=torch.bool)
    covered[-count:] = True
    covered = covered.reshape(24, 30)
    wanted = network(sharp.double(), covered, CODE, 1)
    single = network.float()
    found = single(sharp, covered, CODE.float(), 1)
    assert ((found > 0)[..., 0] == covered).all()
    torch.testing.assert_close(found.double(), wanted, atol=5e-3, rtol=0)
    found.sum().backward()
    assert all(torch.isfinite(value.grad).all() for value in single.parameters())


@pytest.mark.parametrize("size", [(4, 4), (1, 5), (5, 1)])
def test_the_gradient_is_that_of_differences(network, size):
    small = picture()[: size[0], : size[1]].clone().requires_grad_()
    covered = torch.ones(size, dtype=torch.bool)
    covered[0, 0] = False
    code = CODE.clone().requires_grad_()
    assert torch.autograd.gradcheck(lambda x, c: network(x, covered, c, 0), (small, code))


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
