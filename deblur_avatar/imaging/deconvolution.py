"""Deconvolution by line-shaped point spread functions, a different one at every place.

Conventions. Layers are planes [D, H, W] that were blurred together: colours in the light that was
averaged, and the matte. A line PSF is a line of even weight: length in pixels, angle in radians
from +X towards +Y. Pictures go on beyond their edges as they end there.

The matte tells which PSF is right: of a sharp one nearly every pixel is 0 or 1, and a wrong PSF
leaves values between or beyond. PSFs are tried one by one; each pixel takes the one whose matte is
least ambiguous in the window around it.

Sources: Jia, "Single image motion deblurring using transparency", CVPR 2007, for the matte as
witness; Hunt, "The application of constrained least squares estimation to image restoration by
digital computer", IEEE Trans. Computers 1973, for the filter.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from kornia.filters import get_gaussian_kernel1d
from torch import Tensor
from torch.nn import functional

STEPS_A_PIXEL = 8  # points of a line PSF
CLEAR = 1e-4  # of `matte_ambiguity` that nobody sees: empty windows stay as they are


def line_psf(length: float, angle: float, height: int, width: int) -> Float[Tensor, "H W"]:
    """Point spread function of a line; its sum is 1.

    Its middle lies in the corner [0, 0], as Fourier transforms want it. Points are shared among the
    four nearest pixels, so that no angle is preferred.
    """
    count = max(round(length * STEPS_A_PIXEL), 1)
    offsets = ((torch.arange(count, dtype=torch.float64) + 0.5) / count - 0.5) * length
    kernel = torch.zeros(height, width, dtype=torch.float64)
    x, y = offsets * math.cos(angle), offsets * math.sin(angle)
    left, top = x.floor(), y.floor()
    for dx in (0, 1):
        for dy in (0, 1):
            share = (1 - (x - left - dx).abs()) * (1 - (y - top - dy).abs()) / count
            place = ((top + dy).long() % height, (left + dx).long() % width)
            kernel.index_put_(place, share, accumulate=True)
    return kernel.float()


def constrained_least_squares(
    spectrum: Tensor, kernel: Float[Tensor, "H W"], regularisation: float
) -> Float[Tensor, "D H W"]:
    """Constrained least squares deconvolution (Hunt 1973): take one kernel's blur away.

    Args:
        spectrum: `torch.fft.rfft2` of the layers.
        kernel: what they were blurred with.
        regularisation: weight of smoothness (the Laplacian's square) against explaining the layers,
            as in scikit-image's `wiener`.
    """
    height, width = kernel.shape
    laplacian = kernel.new_zeros(height, width)
    laplacian[0, 0] = 4
    for row, column in ((0, 1), (1, 0), (-1, 0), (0, -1)):
        laplacian[row, column] -= 1
    blur, rough = torch.fft.rfft2(kernel), torch.fft.rfft2(laplacian)
    gain = blur.conj() / (blur.abs().square() + regularisation * rough.abs().square())
    return torch.fft.irfft2(spectrum * gain, s=(height, width))


def matte_ambiguity(matte: Float[Tensor, "H W"], window_sigma: float) -> Float[Tensor, "H W"]:
    """Matte ambiguity: how far coverage is from 0 or 1, |a (1 - a)| in a window at each pixel.

    Args:
        matte: coverage; values beyond 0 and 1 count too.
        window_sigma: standard deviation of the Gaussian window, pixels.
    """
    reach = math.ceil(3 * window_sigma)
    window = get_gaussian_kernel1d(2 * reach + 1, window_sigma, dtype=matte.dtype)[0]
    values = (matte * (1 - matte)).abs()[None, None]
    rows = functional.conv2d(values, window[None, None, :, None], padding=(reach, 0))
    return functional.conv2d(rows, window[None, None, None, :], padding=(0, reach))[0, 0]


def deblur_by_matte(
    layers: Float[Tensor, "D H W"],
    lengths: Sequence[float],
    angles: int,
    *,
    regularisation: float,
    window_sigma: float,
    gain: float,
) -> tuple[Float[Tensor, "D H W"], Float[Tensor, "H W"]]:
    """Sharpen all layers, at each pixel by the line PSF that leaves the matte least ambiguous.

    Args:
        layers: in [0, 1], the matte last.
        lengths: of the line PSFs tried, pixels.
        angles: how many directions are tried, evenly over half a turn.
        regularisation: of the filter, see `constrained_least_squares`.
        window_sigma: pixels, see `matte_ambiguity`.
        gain: share by which the matte must become clearer before anything is changed.

    Returns:
        The layers in [0, 1], and the length of the line PSF taken at each pixel, 0 for none.
    """
    pad = math.ceil(max(lengths))  # what comes in from beyond an edge stays there
    whole = functional.pad(layers[None], (pad,) * 4, mode="replicate")[0]
    spectrum = torch.fft.rfft2(whole)
    least = (matte_ambiguity(whole[-1], window_sigma) + CLEAR) * (1 - gain)
    best, chosen = whole, torch.zeros_like(least)
    for length in lengths:
        for step in range(angles):
            kernel = line_psf(length, math.pi * step / angles, *least.shape).to(layers)
            tried = constrained_least_squares(spectrum, kernel, regularisation)
            left = matte_ambiguity(tried[-1], window_sigma) + CLEAR
            better = left < least
            least = torch.where(better, left, least)
            best = torch.where(better, tried, best)
            chosen = torch.where(better, length, chosen)
    inside = (..., slice(pad, -pad), slice(pad, -pad))
    return best[inside].clamp(0, 1), chosen[inside]
