import torch
from torch.nn import functional

from deblur_avatar.imaging.dynamic_filters import TAPS, filter_by_channel, filter_by_pixel


def drawn(*shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def test_a_channel_s_kernel_is_a_convolution_with_zeros_around():
    image, taps = drawn(2, 3, 5, 4), drawn(2, 3, TAPS)
    made = filter_by_channel(image, taps)
    for frame in range(2):
        for channel in range(3):
            kernel = taps[frame, channel].view(1, 1, 3, 3)
            wanted = functional.conv2d(image[frame, channel][None, None], kernel, padding=1)
            torch.testing.assert_close(made[frame, channel], wanted[0, 0])


def test_a_pixel_s_kernel_is_its_own():
    image, taps = drawn(2, 3, 5, 4), drawn(2, 3, TAPS, 5, 4)
    made = filter_by_pixel(image, taps)
    padded = functional.pad(image, (1, 1, 1, 1))
    for row, column in ((0, 0), (2, 3), (4, 1)):
        around = padded[..., row : row + 3, column : column + 3].flatten(-2)
        torch.testing.assert_close(
            made[..., row, column], (around * taps[..., row, column]).sum(-1)
        )


def test_the_same_kernel_everywhere_is_a_channel_s():
    image, taps = drawn(1, 2, 6, 6), drawn(1, 2, TAPS)
    everywhere = taps[..., None, None].expand(-1, -1, -1, 6, 6)
    torch.testing.assert_close(filter_by_pixel(image, everywhere), filter_by_channel(image, taps))


def test_gradients_reach_picture_and_kernels():
    image, taps = drawn(1, 1, 3, 3).requires_grad_(), drawn(1, 1, TAPS, 3, 3).requires_grad_()
    assert torch.autograd.gradcheck(filter_by_pixel, (image, taps))
