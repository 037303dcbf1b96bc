import pytest
import torch

from deblur_avatar.imaging.haar import haar, inverse_haar


def test_a_square_s_bands_are_its_mean_and_its_differences():
    square = torch.tensor([[1.0, 2.0], [4.0, 9.0]])[None]
    low, high = haar(square)
    assert low.flatten().tolist() == [4.0]
    # (a + c) - (b + d), (a + b) - (c + d), (a + d) - (b + c), a quarter of each.
    assert high.flatten().tolist() == [-1.5, -2.5, 1.0]


@pytest.mark.parametrize("shape", [(1, 2, 2), (3, 6, 4), (2, 5, 3, 8, 6)])
def test_what_was_split_is_joined_again(shape):
    image = torch.randn(shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    low, high = haar(image)
    assert low.shape == (*shape[:-2], shape[-2] // 2, shape[-1] // 2)
    assert high.shape[-3] == 3 * shape[-3]
    torch.testing.assert_close(inverse_haar(low, high), image)


def test_an_even_picture_has_no_high_bands_and_keeps_its_brightness():
    low, high = haar(torch.full((4, 8, 8), 0.3))
    assert torch.allclose(low, torch.tensor(0.3))
    assert float(high.abs().max()) < 1e-7


def test_bands_come_one_direction_after_the_other_for_all_channels():
    stripes = torch.zeros(2, 4, 4)
    stripes[1, :, 0::2] = 1.0  # of the second channel, along x
    _, high = haar(stripes)
    assert [index for index, band in enumerate(high) if band.abs().max() > 0] == [1]
