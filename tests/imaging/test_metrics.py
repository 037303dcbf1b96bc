import math

import flip_evaluator
import numpy as np
import pytest
import torch
from kornia import metrics as kornia_metrics
from scipy.ndimage import correlate1d
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from deblur_avatar.imaging import metrics

pytestmark = pytest.mark.portable

TOLERANCE = 1e-4


def pictures(height: int = 40, width: int = 33) -> tuple[torch.Tensor, torch.Tensor]:
    """Two smooth truths and noisy renders of them, as different from each other as renders are."""
    generator = torch.Generator().manual_seed(0)
    coarse = torch.rand(2, 3, 6, 6, generator=generator)
    truth = torch.nn.functional.interpolate(
        coarse, (height, width), mode="bicubic", align_corners=False
    ).clamp(0, 1)
    render = truth + 0.08 * torch.randn(truth.shape, generator=generator)
    return render.clamp(0, 1).permute(0, 2, 3, 1), truth.permute(0, 2, 3, 1)


def half_mask(images: torch.Tensor) -> torch.Tensor:
    mask = torch.zeros(images.shape[:3], dtype=torch.bool)
    mask[:, :, : images.shape[2] // 2] = True
    return mask


def each(function, render: torch.Tensor, truth: torch.Tensor) -> list[float]:
    pairs = zip(render.double().numpy(), truth.double().numpy(), strict=True)
    return [float(function(a, b)) for a, b in pairs]


# --- value ---------------------------------------------------------------------------------------


def test_psnr_is_scikit_images_and_kornias():
    render, truth = pictures()
    expected = each(lambda a, b: peak_signal_noise_ratio(b, a, data_range=1), render, truth)
    assert metrics.psnr(render, truth).tolist() == pytest.approx(expected, abs=TOLERANCE)
    kornias = [float(kornia_metrics.psnr(a, b, 1.0)) for a, b in zip(render, truth, strict=True)]
    assert metrics.psnr(render, truth).tolist() == pytest.approx(kornias, abs=TOLERANCE)


def test_ssim_is_scikit_images_with_wangs_window():
    render, truth = pictures()
    expected = each(
        lambda a, b: structural_similarity(
            a, b, data_range=1, channel_axis=2, gaussian_weights=True, sigma=1.5,
            use_sample_covariance=False,
        ),
        render, truth,
    )  # fmt: skip
    assert metrics.ssim(render, truth).tolist() == pytest.approx(expected, abs=TOLERANCE)


def test_ssim_is_kornias_away_from_the_border():
    render, truth = pictures()
    planes = [x.permute(0, 3, 1, 2) for x in (render, truth)]
    inside = kornia_metrics.ssim(*planes, window_size=11)[..., 5:-5, 5:-5]
    expected = inside.flatten(1).mean(1).tolist()
    assert metrics.ssim(render, truth).tolist() == pytest.approx(expected, abs=TOLERANCE)


def test_ssim_range2_is_what_old_scikit_image_made_of_floats():
    render, truth = pictures()
    expected = each(
        lambda a, b: structural_similarity(a, b, data_range=2, channel_axis=2), render, truth
    )
    assert metrics.ssim_range2(render, truth).tolist() == pytest.approx(expected, abs=TOLERANCE)


def naive_ms_ssim(a: np.ndarray, b: np.ndarray) -> float:
    """Wang et al. 2003 channel by channel with SciPy's filters."""
    offset = np.arange(11) - 5
    window = np.exp(-(offset**2) / (2 * 1.5**2))
    window /= window.sum()

    def local_mean(x: np.ndarray) -> np.ndarray:
        return correlate1d(correlate1d(x, window, 0), window, 1)[5:-5, 5:-5]

    scores = []
    for channel in range(3):
        x, y = a[..., channel], b[..., channel]
        score = 1.0
        for scale, weight in enumerate((0.0448, 0.2856, 0.3001, 0.2363, 0.1333)):
            if scale:
                x, y = (
                    z[: z.shape[0] // 2 * 2, : z.shape[1] // 2 * 2]
                    .reshape(z.shape[0] // 2, 2, z.shape[1] // 2, 2)
                    .mean((1, 3))
                    for z in (x, y)
                )
            mx, my = local_mean(x), local_mean(y)
            vx, vy = local_mean(x * x) - mx**2, local_mean(y * y) - my**2
            term = (2 * (local_mean(x * y) - mx * my) + 0.03**2) / (vx + vy + 0.03**2)
            if scale == 4:
                term = term * (2 * mx * my + 0.01**2) / (mx**2 + my**2 + 0.01**2)
            score *= term.mean() ** weight
        scores.append(score)
    return float(np.mean(scores))


def test_ms_ssim_is_the_published_product_over_five_scales():
    render, truth = pictures(181, 190)
    expected = each(naive_ms_ssim, render, truth)
    assert metrics.ms_ssim(render, truth).tolist() == pytest.approx(expected, abs=TOLERANCE)
    assert 0.3 < expected[0] < 0.99


def test_flip_is_nvidias():
    render, truth = pictures()
    expected = [
        flip_evaluator.evaluate(b.numpy(), a.numpy(), "LDR")[1]
        for a, b in zip(render, truth, strict=True)
    ]
    assert metrics.flip(render, truth).tolist() == pytest.approx(expected, abs=TOLERANCE)


def test_flip_is_the_published_formula_on_plain_colours():
    """With nothing to filter and no edge, FLIP is its colour pipeline alone."""
    colours = np.array([[0.8, 0.3, 0.2], [0.2, 0.4, 0.7]])
    truth, render = (
        torch.tensor(c, dtype=torch.float32).expand(1, 32, 32, 3).contiguous() for c in colours
    )
    expected = published_flip_of_plain_colours(*colours)
    assert float(metrics.flip(render, truth)) == pytest.approx(expected, abs=TOLERANCE)


def published_flip_of_plain_colours(a: np.ndarray, b: np.ndarray) -> float:
    """Andersson et al. 2020, sections 4.1.2 to 4.3, for pictures of one colour."""
    to_xyz = np.array(
        [
            [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
            [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
            [1425312 / 73733382, 8788810 / 73733382, 70074375 / 73733382],
        ]
    )
    white = to_xyz @ np.ones(3)

    def hunt_lab(rgb: np.ndarray) -> np.ndarray:
        t = to_xyz @ rgb / white
        delta = 6 / 29
        f = np.where(t > delta**3, np.cbrt(t), t / (3 * delta**2) + 4 / 29)
        lightness = 116 * f[1] - 16
        chroma = np.array([500 * (f[0] - f[1]), 200 * (f[1] - f[2])])
        return np.array([lightness, *(0.01 * lightness * chroma)])

    def hyab(x: np.ndarray, y: np.ndarray) -> float:
        return float(abs(x[0] - y[0]) + np.hypot(*(x - y)[1:]))

    def linear(srgb: np.ndarray) -> np.ndarray:
        return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)

    largest = hyab(hunt_lab(np.array([0.0, 1, 0])), hunt_lab(np.array([0.0, 0, 1]))) ** 0.7
    error = hyab(hunt_lab(linear(a)), hunt_lab(linear(b))) ** 0.7
    knee, share = 0.4 * largest, 0.95
    if error < knee:
        return share / knee * error
    return share + (error - knee) / (largest - knee) * (1 - share)


def test_sharpness_ratio_is_one_for_the_truth_and_a_quarter_at_half_the_contrast():
    _, truth = pictures()
    mask = half_mask(truth)
    assert metrics.sharpness_ratio(truth, truth, mask).tolist() == [1, 1]
    faded = truth * 0.5 + 0.2
    assert metrics.sharpness_ratio(faded, truth, mask).tolist() == pytest.approx([0.25, 0.25])


def test_sharpness_ratio_counts_differences_inside_the_mask_alone():
    truth = torch.zeros(1, 1, 4, 3)
    truth[..., 1:, :] = torch.tensor([0.2, 0.6, 1.0])[:, None]
    render = truth.clone()
    render[..., 0, :] = 0.9  # outside
    render[..., 3, :] = 0.8
    mask = torch.tensor([[[False, True, True, True]]])
    # Differences inside: 0.4, 0.4 in the truth, and 0.4, 0.2 in the render.
    assert float(metrics.sharpness_ratio(render, truth, mask)) == pytest.approx(0.2 / 0.32)


# --- invariance ----------------------------------------------------------------------------------

WHOLE = {
    "psnr": metrics.psnr,
    "ssim": metrics.ssim,
    "ssim_range2": metrics.ssim_range2,
    "flip": metrics.flip,
}


@pytest.mark.parametrize("metric", WHOLE.values(), ids=WHOLE)
def test_turning_both_pictures_changes_nothing(metric):
    render, truth = pictures()
    turned = metric(render.transpose(1, 2).contiguous(), truth.transpose(1, 2).contiguous())
    torch.testing.assert_close(turned, metric(render, truth), atol=1e-5, rtol=0)


@pytest.mark.parametrize("metric", WHOLE.values(), ids=WHOLE)
def test_a_picture_is_scored_as_it_would_be_alone(metric):
    render, truth = pictures()
    alone = torch.cat([metric(render[i : i + 1], truth[i : i + 1]) for i in range(2)])
    torch.testing.assert_close(metric(render, truth), alone)


@pytest.mark.parametrize("metric", [metrics.psnr, metrics.ssim, metrics.flip])
def test_a_full_mask_is_no_mask(metric):
    render, truth = pictures()
    full = torch.ones(render.shape[:3], dtype=torch.bool)
    torch.testing.assert_close(metric(render, truth, full), metric(render, truth))


def test_masked_ssim_is_the_mean_of_scikit_images_map_over_the_mask():
    render, truth = pictures()
    mask = half_mask(truth)
    expected = []
    for a, b, inside in zip(render.double().numpy(), truth.double().numpy(), mask, strict=True):
        _, similarity = structural_similarity(
            a, b, data_range=1, channel_axis=2, gaussian_weights=True, sigma=1.5,
            use_sample_covariance=False, full=True,
        )  # fmt: skip
        interior = similarity[5:-5, 5:-5].mean(-1)
        expected.append(float(interior[inside[5:-5, 5:-5].numpy()].mean()))
    assert metrics.ssim(render, truth, mask).tolist() == pytest.approx(expected, abs=TOLERANCE)


def test_what_lies_outside_the_mask_does_not_count():
    render, truth = pictures()
    mask = half_mask(truth)
    spoilt = torch.where(mask[..., None], render, 1 - render)
    torch.testing.assert_close(metrics.psnr(spoilt, truth, mask), metrics.psnr(render, truth, mask))
    expected = peak_signal_noise_ratio(
        truth[mask].double().numpy(), render[mask].double().numpy(), data_range=1
    )
    both = metrics.psnr(render, truth, mask)
    mean_error = (10 ** (-both / 10)).mean()
    assert float(-10 * mean_error.log10()) == pytest.approx(expected, abs=TOLERANCE)


def test_masked_flip_is_the_mean_of_the_map_over_the_mask():
    render, truth = pictures()
    mask = half_mask(truth)
    expected = [
        float(m[k].mean()) for m, k in zip(metrics.flip_map(render, truth), mask, strict=True)
    ]
    assert metrics.flip(render, truth, mask).tolist() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("metric", WHOLE.values(), ids=WHOLE)
def test_a_render_beyond_white_is_scored_as_the_display_shows_it(metric):
    render, truth = pictures()
    bright = render + 0.5 * (render == 1) - 0.5 * (render == 0)
    assert not torch.equal(bright, render)
    torch.testing.assert_close(metric(bright, truth), metric(render, truth))


# --- edge and gradient ---------------------------------------------------------------------------


def test_equal_pictures_score_best():
    _, truth = pictures(176, 176)
    assert metrics.psnr(truth, truth).tolist() == [math.inf, math.inf]
    assert metrics.flip(truth, truth).tolist() == [0, 0]
    for metric in (metrics.ssim, metrics.ssim_range2, metrics.ms_ssim):
        assert metric(truth, truth).tolist() == pytest.approx([1, 1], abs=1e-9)


def test_an_empty_mask_is_not_measured():
    render, truth = pictures()
    empty = torch.zeros(render.shape[:3], dtype=torch.bool)
    assert metrics.psnr(render, truth, empty).isnan().all()
    assert metrics.flip(render, truth, empty).isnan().all()
    assert metrics.ssim(render, truth, empty).isnan().all()
    assert metrics.sharpness_ratio(render, truth, empty).isnan().all()


def test_the_sharpness_of_a_flat_truth_is_not_measured():
    render, _ = pictures()
    flat = torch.full_like(render, 0.5)
    assert metrics.sharpness_ratio(render, flat, half_mask(flat)).isnan().all()


@pytest.mark.parametrize(
    ("metric", "side"), [(metrics.ssim, 11), (metrics.ssim_range2, 7), (metrics.ms_ssim, 176)]
)
def test_pictures_smaller_than_the_window_are_not_measured(metric, side):
    assert metric(*pictures(side, side - 1)).isnan().all()
    assert metric(*pictures(side, side)).isfinite().all()


@pytest.mark.parametrize("metric", [metrics.psnr, metrics.ssim, metrics.ssim_range2])
def test_gradients_are_those_of_finite_differences(metric):
    render, truth = (x[:1, :12, :11].double() * 0.8 + 0.1 for x in pictures())
    assert torch.autograd.gradcheck(
        lambda x: metric(x, truth), render.requires_grad_(), fast_mode=True
    )
