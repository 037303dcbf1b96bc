import math

import pytest
import torch
from skimage import restoration

from deblur_avatar.imaging.deconvolution import (
    constrained_least_squares,
    deblur_by_matte,
    line_psf,
    matte_ambiguity,
)

pytestmark = pytest.mark.portable

SETTINGS = {"regularisation": 0.002, "window_sigma": 4.0, "gain": 0.05}


def layers(size: int = 64) -> torch.Tensor:
    """A striped disc on black, its matte last."""
    y, x = torch.meshgrid(torch.arange(size), torch.arange(size), indexing="ij")
    disc = ((x - size / 2) ** 2 + (y - size / 2) ** 2 < (size / 4) ** 2).float()
    stripes = 0.6 + 0.4 * torch.sin(0.8 * x)
    return torch.stack([disc * stripes, disc * 0.5, disc * (1 - stripes / 2), disc])


def blurred(pictures: torch.Tensor, length: float, angle: float) -> torch.Tensor:
    kernel = torch.fft.rfft2(line_psf(length, angle, *pictures.shape[1:]))
    return torch.fft.irfft2(torch.fft.rfft2(pictures) * kernel, s=pictures.shape[1:]).clamp(0, 1)


def error(a: torch.Tensor, b: torch.Tensor) -> float:
    return float((a - b).square().mean())


def test_a_streak_is_as_long_as_it_says_and_centred():
    kernel = torch.fft.fftshift(line_psf(9.0, math.pi / 2, 32, 32)).double()
    rows = torch.arange(32) - 16.0
    assert kernel.sum() == pytest.approx(1.0)
    assert (kernel.sum(1) * rows).sum() == pytest.approx(0.0, abs=1e-6)
    # A line's variance, and what sharing between neighbouring pixels adds on average.
    assert (kernel.sum(1) * rows**2).sum() == pytest.approx(81 / 12 + 1 / 6, rel=0.01)
    assert kernel.sum(0)[16] == pytest.approx(1.0)


def test_the_filter_is_scikit_images():
    generator = torch.Generator().manual_seed(0)
    picture = torch.rand(1, 32, 32, generator=generator, dtype=torch.float64)
    kernel = line_psf(5.0, 0.4, 32, 32).double()
    ours = constrained_least_squares(torch.fft.rfft2(picture), kernel, 0.3)[0]
    middle = torch.fft.fftshift(kernel).numpy()
    theirs = restoration.wiener(picture[0].numpy(), middle, 0.3, clip=False)
    shifted = torch.roll(torch.from_numpy(theirs), (16, 16), (0, 1))
    best = min(
        float((ours - torch.roll(shifted, (i, j), (0, 1))).abs().max())
        for i in (-16, 0) for j in (-16, 0)
    )  # fmt: skip
    assert best < 1e-6


def test_only_coverage_that_is_all_or_nothing_is_clear():
    matte = layers()[-1]
    assert matte_ambiguity(matte, 3.0).abs().max() == 0
    assert matte_ambiguity(matte * 0.5, 3.0)[32, 32] > 0.2
    assert matte_ambiguity(matte * 1.5, 3.0)[32, 32] > 0.2  # ringing beyond 1


@pytest.mark.parametrize("angle", [0.0, math.pi / 4, math.pi / 2])
def test_a_streak_is_undone_better_than_left_alone(angle: float):
    sharp = layers()
    soft = blurred(sharp, 8.0, angle)
    made, lengths = deblur_by_matte(soft, (4.0, 8.0), 4, **SETTINGS)
    assert error(made[:3], sharp[:3]) < 0.6 * error(soft[:3], sharp[:3])
    assert error(made[3], sharp[3]) < 0.5 * error(soft[3], sharp[3])
    edge = soft[3] * (1 - soft[3]) > 0.1
    assert lengths[edge].median() == 8.0


def test_each_place_finds_its_own_streak():
    left = blurred(layers(), 8.0, 0.0)
    soft = torch.cat([left, layers()], dim=2)
    _, lengths = deblur_by_matte(soft, (8.0,), 4, **(SETTINGS | {"regularisation": 0.05}))
    still = lengths[:, 72:]
    assert still.max() == 0
    assert lengths[:, :56].max() == 8.0


def test_a_sharp_picture_stays_as_it_is():
    sharp = layers()
    made, lengths = deblur_by_matte(sharp, (4.0, 8.0), 4, **SETTINGS)
    assert torch.equal(made, sharp)
    assert lengths.max() == 0
