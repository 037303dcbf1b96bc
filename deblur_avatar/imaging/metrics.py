"""Image metrics: how far a render is from the ground truth.

The table of those that are reported is `evaluation/metrics.py`.

Conventions. Images are sRGB in [0, 1] (`render` is clamped to it, as any display would), masks are
boolean, B pictures a call; every metric returns one value a picture, computed in float64. A mask
without a pixel, or a picture too small for a metric, gives NaN, which reports show as "not
measured". Where nothing else is said all pixels count, background included.

Sources: Wang et al., "Image quality assessment: from error visibility to structural similarity",
IEEE TIP 2004; Wang et al., "Multiscale structural similarity for image quality assessment",
Asilomar 2003; Andersson et al., "FLIP: a difference evaluator for alternating images", HPG 2020.
"""

import flip_evaluator
import numpy as np
import torch
from jaxtyping import Bool, Float
from kornia.filters import get_gaussian_kernel1d
from torch import Tensor
from torch.nn import functional

Images = Float[Tensor, "B H W 3"]
Masks = Bool[Tensor, "B H W"]
Scores = Float[Tensor, " B"]

K1, K2 = 0.01, 0.03  # SSIM's stabilisers, as shares of the data range
GAUSSIAN_SIZE, GAUSSIAN_SIGMA = 11, 1.5  # pixels
UNIFORM_SIZE = 7  # pixels
MS_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # Wang et al. 2003, finest scale first
MS_SMALLEST_SIDE = GAUSSIAN_SIZE * 2 ** (len(MS_WEIGHTS) - 1)  # pixels
PIXELS_PER_DEGREE = 67.0  # FLIP's default viewing: a 0.7 m wide 4K display seen from 0.7 m


def psnr(render: Images, truth: Images, mask: Masks | None = None) -> Scores:
    """Peak signal-to-noise ratio, dB: the error is averaged over pixels and channels alike.

    Data range 1, sRGB values; over the pixels of `mask` where one is given. Equal pictures: inf.
    """
    error = (_prepared(render) - _prepared(truth)).square().mean(-1)
    if mask is None:
        return -10 * error.mean((1, 2)).log10()
    return -10 * masked_mean(error, mask).log10()


def ssim(render: Images, truth: Images, mask: Masks | None = None) -> Scores:
    """Structural similarity: data range 1, Gaussian window 11 x 11 of sigma 1.5.

    Mean over channels and over pixels whose window lies inside the picture (Wang et al. 2004); of
    these, over those of `mask` where one is given (their windows may reach out of it).
    """
    if min(render.shape[1:3]) < GAUSSIAN_SIZE:
        return _not_measured(render)
    window = _gaussian_window()
    similarity, _ = _similarity(_planes(render), _planes(truth), window, 1.0, 1.0)
    if mask is None:
        return similarity.flatten(1).mean(1)
    edge = GAUSSIAN_SIZE // 2
    return masked_mean(similarity.mean(1), mask[:, edge:-edge, edge:-edge])


def ssim_range2(render: Images, truth: Images) -> Scores:
    """Structural similarity as published avatar tables have it, which reads higher than `ssim`.

    Uniform window 7 x 7, sample covariance (N / (N - 1)), data range 2 although values span 1, mean
    over channels and the interior. Source: scikit-image before 0.20 when given floats in [0, 1].
    """
    if min(render.shape[1:3]) < UNIFORM_SIZE:
        return _not_measured(render)
    count = UNIFORM_SIZE**2
    window = torch.full((UNIFORM_SIZE,), 1 / UNIFORM_SIZE, dtype=torch.float64)
    similarity, _ = _similarity(_planes(render), _planes(truth), window, 2.0, count / (count - 1))
    return similarity.flatten(1).mean(1)


def ms_ssim(render: Images, truth: Images) -> Scores:
    """Structural similarity over five scales, each half the last (2 x 2 means); data range 1.

    Contrast and structure of every scale, luminance of the coarsest, raised to the published
    weights and multiplied; `ssim`'s window. Negative terms count as 0. NaN for pictures with a side
    under `MS_SMALLEST_SIDE`.
    """
    if min(render.shape[1:3]) < MS_SMALLEST_SIDE:
        return _not_measured(render)
    window = _gaussian_window()
    a, b = _planes(render), _planes(truth)
    score = a.new_ones(a.shape[:2])
    for scale, weight in enumerate(MS_WEIGHTS):
        if scale:
            a, b = functional.avg_pool2d(a, 2), functional.avg_pool2d(b, 2)
        similarity, contrast = _similarity(a, b, window, 1.0, 1.0)
        last = scale == len(MS_WEIGHTS) - 1
        score = score * (similarity if last else contrast).mean((2, 3)).clamp(min=0) ** weight
    return score.mean(1)


def flip_map(render: Images, truth: Images) -> Float[Tensor, "B H W"]:
    """Perceived difference at each pixel in [0, 1], as when the two pictures alternate on a screen.

    NVIDIA's FLIP for low dynamic range, computed by its authors' own library; inputs sRGB,
    `PIXELS_PER_DEGREE` pixels a degree of the eye.
    """
    maps = []
    for picture, reference in zip(_prepared(render), _prepared(truth), strict=True):
        errors, _, _ = flip_evaluator.evaluate(
            reference.float().cpu().numpy(),
            picture.float().cpu().numpy(),
            "LDR",
            applyMagma=False,
            computeMeanError=False,
            parameters={"ppd": PIXELS_PER_DEGREE},
        )
        maps.append(torch.from_numpy(np.array(errors[..., 0])))
    return torch.stack(maps).to(render.device)


def flip(render: Images, truth: Images, mask: Masks | None = None) -> Scores:
    """Mean of `flip_map` over all pixels, or over those of `mask`; 0 is equal, 1 is worst."""
    errors = flip_map(render, truth).double()
    return errors.mean((1, 2)) if mask is None else masked_mean(errors, mask)


def sharpness_ratio(render: Images, truth: Images, mask: Masks) -> Scores:
    """Gradient energy of the picture over that of the truth, inside the person.

    1 is as sharp as the truth, less is blurred, more is noise. The energy is the mean square of
    differences of sRGB values between neighbours that both lie in `mask`, so that the outline
    against the background does not count. NaN where the truth is flat.
    """
    truth_energy = _gradient_energy(_prepared(truth), mask)
    ratio = _gradient_energy(_prepared(render), mask) / truth_energy
    return torch.where(truth_energy > 0, ratio, torch.nan)


def masked_mean(values: Float[Tensor, "B H W"], mask: Masks) -> Scores:
    """Mean over the pixels of each mask; NaN for a mask without one."""
    return (values * mask).sum((1, 2)) / mask.sum((1, 2))


def _prepared(images: Images) -> Images:
    return images.double().clamp(0, 1)


def _planes(images: Images) -> Float[Tensor, "B 3 H W"]:
    return _prepared(images).permute(0, 3, 1, 2)


def _not_measured(images: Images) -> Scores:
    return images.new_full((len(images),), torch.nan, dtype=torch.float64)


def _gaussian_window() -> Float[Tensor, " S"]:
    return get_gaussian_kernel1d(GAUSSIAN_SIZE, GAUSSIAN_SIGMA, dtype=torch.float64)[0]


def _similarity(
    a: Float[Tensor, "B 3 H W"],
    b: Float[Tensor, "B 3 H W"],
    window: Float[Tensor, " S"],
    data_range: float,
    covariance_scale: float,
) -> tuple[Float[Tensor, "B 3 h w"], Float[Tensor, "B 3 h w"]]:
    """SSIM, and its contrast-structure factor, at every pixel whose window is inside."""
    means = _filtered(torch.cat([a, b, a * a, b * b, a * b], dim=1), window)
    mean_a, mean_b, square_a, square_b, product = means.chunk(5, dim=1)
    variance_a = covariance_scale * (square_a - mean_a**2)
    variance_b = covariance_scale * (square_b - mean_b**2)
    covariance = covariance_scale * (product - mean_a * mean_b)
    c1, c2 = (K1 * data_range) ** 2, (K2 * data_range) ** 2
    contrast = (2 * covariance + c2) / (variance_a + variance_b + c2)
    luminance = (2 * mean_a * mean_b + c1) / (mean_a**2 + mean_b**2 + c1)
    return luminance * contrast, contrast


def _filtered(
    planes: Float[Tensor, "B D H W"], window: Float[Tensor, " S"]
) -> Float[Tensor, "B D h w"]:
    """Weighted means over windows inside the picture: sums of shifted copies.

    Ten times as fast as a grouped convolution, which has no fast float64 form on CPUs.
    """
    for axis in (3, 2):
        size = planes.shape[axis] - len(window) + 1
        total = planes.narrow(axis, 0, size) * window[0]
        for offset in range(1, len(window)):
            total.add_(planes.narrow(axis, offset, size), alpha=float(window[offset]))
        planes = total
    return planes


def _gradient_energy(images: Images, mask: Masks) -> Scores:
    energy = images.new_zeros(len(images))
    count = images.new_zeros(len(images))
    for axis in (1, 2):
        size = images.shape[axis]
        step = images.narrow(axis, 1, size - 1) - images.narrow(axis, 0, size - 1)
        inside = mask.narrow(axis, 1, size - 1) & mask.narrow(axis, 0, size - 1)
        energy = energy + (step.square().mean(-1) * inside).sum((1, 2))
        count = count + inside.sum((1, 2))
    return energy / count
