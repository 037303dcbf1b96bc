import pytest
import torch

from deblur_avatar.imaging.dstnet import LAYERS, Dstnet, DstnetParams, restore

SMALL = DstnetParams(features=4, blocks=1, refinements=1)
SIZE = 16


def clip(frames: int = 5, height: int = SIZE, width: int = SIZE) -> torch.Tensor:
    generator = torch.Generator().manual_seed(2)
    return torch.rand(1, frames, LAYERS, height, width, generator=generator)


@pytest.fixture
def network() -> Dstnet:
    """One whose last layer says something."""
    torch.manual_seed(5)
    made = Dstnet(SMALL)
    torch.nn.init.normal_(made.leave.weight, std=0.1)
    return made.eval()


def test_untrained_it_gives_the_clip_itself():
    torch.manual_seed(0)
    assert torch.equal(Dstnet(SMALL)(clip()), clip())


def test_the_network_that_is_shipped_has_so_many_numbers():
    network = Dstnet(DstnetParams(features=16, blocks=2, refinements=2))
    assert sum(parameter.numel() for parameter in network.parameters()) == 104_436


def test_every_frame_learns_from_those_before_it_and_after_it(network):
    given = clip(9).requires_grad_()  # aggregation alone reaches two frames each way
    network(given)[0, 4].sum().backward()
    reached = given.grad[0].abs().amax((1, 2, 3))
    assert bool((reached > 0).all())


def test_every_number_of_it_is_trained(network):
    network.train()
    (network(clip()) ** 2).mean().backward()
    # The norm's shift and the widening's bias reach the loss by paths that products leave open.
    without = [n for n, p in network.named_parameters() if p.grad is None or not p.grad.any()]
    assert without == []


def test_clips_of_a_batch_do_not_see_each_other(network):
    both = torch.cat([clip(), clip().flip(-1)])
    torch.testing.assert_close(network(both)[:1], network(clip()), atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize(("height", "width"), [(16, 16), (17, 30), (5, 9)])
def test_clips_of_any_size_are_restored_within_zero_and_one(network, height, width):
    bright = 1.2 * clip(3, height, width)[0] - 0.1
    made = restore(network, bright)
    assert made.shape == bright.shape
    assert float(made.min()) >= 0
    assert float(made.max()) <= 1
    assert not made.requires_grad


def test_what_lies_beyond_an_edge_is_not_needed(network):
    """A picture that ends as it is padded gives what the picture alone gives."""
    whole = clip(2, 16, 16)[0]
    whole[..., 12:] = whole[..., 11:12]
    part = restore(network, whole[..., :12])
    torch.testing.assert_close(part, restore(network, whole)[..., :12])
