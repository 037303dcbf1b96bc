import math

import pytest
import torch

from deblur_avatar.avatars.frequency_encoding import frequency_encoding, hann_window

pytestmark = pytest.mark.portable


def test_values_are_sines_then_cosines_of_doubling_frequencies():
    encoded = frequency_encoding(torch.tensor([[0.3, -2.0]]), 3)
    wanted = [
        function(factor * value)
        for factor in (1, 2, 4)
        for function in (math.sin, math.cos)
        for value in (0.3, -2.0)
    ]
    torch.testing.assert_close(encoded, torch.tensor([wanted]))


def test_a_window_weighs_whole_frequencies():
    values = torch.randn(5, 3, generator=torch.Generator().manual_seed(0))
    whole = frequency_encoding(values, 2)
    torch.testing.assert_close(frequency_encoding(values, 2, (1.0, 1.0)), whole)
    weighed = frequency_encoding(values, 2, (0.5, 0.0))
    torch.testing.assert_close(weighed[:, :6], whole[:, :6] / 2)
    assert torch.equal(weighed[:, 6:], torch.zeros(5, 6))


@pytest.mark.parametrize(
    ("share", "weights"),
    [
        (0.0, (0.0, 0.0, 0.0)),
        (1 / 6, (0.5, 0.0, 0.0)),  # half of the first third
        (1 / 3, (1.0, 0.0, 0.0)),
        (1 / 3 + 1 / 9, (1.0, 0.25, 0.0)),  # a third of the way: (1 - cos 60 degrees) / 2
        (1.0, (1.0, 1.0, 1.0)),
        (7.0, (1.0, 1.0, 1.0)),
        (-1.0, (0.0, 0.0, 0.0)),
    ],
)
def test_the_window_opens_one_frequency_after_the_other(share, weights):
    assert hann_window(share, 3) == pytest.approx(weights, abs=1e-12)


def test_a_window_of_another_length_is_refused():
    with pytest.raises(ValueError, match="a window must have 3 weights, got 2"):
        frequency_encoding(torch.zeros(1, 3), 3, (1.0, 1.0))


def test_gradients():
    values = torch.randn(4, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    assert torch.autograd.gradcheck(
        lambda x: frequency_encoding(x, 3, (1.0, 0.5, 0.0)), (values.requires_grad_(),)
    )
