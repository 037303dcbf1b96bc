import numpy as np
import pytest
import torch

from deblur_avatar.imaging.exposure import (
    blur_windows,
    decode,
    encode,
    expose,
    exposure_seconds,
    frames_before,
    frames_with_whole_window,
    mean_of_instants,
    over,
)

pytestmark = pytest.mark.portable

FACTOR, COUNT = 4, 6


def pictures(count: int, depth: int = 3) -> list[np.ndarray]:
    generator = np.random.default_rng(0)
    return list(generator.integers(0, 256, (count, 5, 7, depth), dtype=np.uint8))


def windows(
    images: list[np.ndarray], count: int, window: int, averaging_space: str
) -> list[np.ndarray]:
    return list(blur_windows(images, count, FACTOR, window, averaging_space))


def test_light_adds_up_in_linear_not_in_srgb():
    black_then_white = torch.stack([torch.zeros(1, 1, 3), torch.ones(1, 1, 3)])
    # Half the light of white is sRGB 0.7354 (188 of 255), not 0.5.
    torch.testing.assert_close(
        expose(black_then_white, "linear"), torch.full((1, 1, 3), 0.7354), atol=1e-4, rtol=0
    )
    torch.testing.assert_close(expose(black_then_white, "srgb"), torch.full((1, 1, 3), 0.5))


@pytest.mark.parametrize("averaging_space", ["srgb", "linear"])
def test_a_still_picture_does_not_blur(averaging_space):
    picture = torch.rand(4, 4, 3, dtype=torch.float64)
    torch.testing.assert_close(expose(picture.expand(9, 4, 4, 3), averaging_space), picture)


@pytest.mark.parametrize("averaging_space", ["srgb", "linear"])
def test_the_order_of_sub_frames_is_invisible(averaging_space):
    images = torch.rand(5, 4, 4, 3, dtype=torch.float64)
    torch.testing.assert_close(
        expose(images.flip(0), averaging_space), expose(images, averaging_space)
    )


@pytest.mark.parametrize("averaging_space", ["srgb", "linear"])
def test_gradients_reach_every_sub_frame(averaging_space):
    images = torch.rand(3, 2, 2, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: expose(x, averaging_space), images)


def test_the_mean_of_one_instant_is_that_instant_with_all_of_its_gradient():
    instant = torch.rand(1, 2, 3, 3, requires_grad=True)
    mean = mean_of_instants(instant)
    assert torch.equal(mean, instant[0])
    (grad,) = torch.autograd.grad(mean, instant, torch.full_like(mean, 3.0))
    assert torch.equal(grad, torch.full_like(instant, 3.0))


@pytest.mark.parametrize("averaging_space", ["srgb", "linear"])
def test_the_mean_of_composites_is_the_composite_of_means(averaging_space):
    generator = torch.Generator().manual_seed(4)
    images = torch.rand(5, 6, 7, 3, generator=generator) * 0.5
    alphas = torch.rand(5, 6, 7, generator=generator)
    behind = torch.rand(6, 7, 3, generator=generator)
    light = decode(behind, averaging_space)
    each = [over(image, alpha, light) for image, alpha in zip(images, alphas, strict=True)]
    together = over(mean_of_instants(images), mean_of_instants(alphas), light)
    torch.testing.assert_close(mean_of_instants(torch.stack(each)), together)
    torch.testing.assert_close(encode(light, averaging_space), behind, atol=1e-6, rtol=0)


def test_the_papers_windows_last_as_long_as_the_paper_says():
    lasting = [1e3 * exposure_seconds(window, 8, 60.0) for window in (17, 33, 49)]
    assert lasting == pytest.approx([35.4, 68.8, 102.1], abs=0.05)


@pytest.mark.parametrize(
    ("window", "kept"), [(1, range(6)), (9, range(1, 5)), (11, range(2, 4)), (41, range(5, 1))]
)
def test_frames_whose_window_leaves_the_clip_are_dropped(window, kept):
    assert list(frames_with_whole_window(COUNT, FACTOR, window)) == list(kept)


def test_a_window_without_a_middle_is_refused():
    with pytest.raises(ValueError, match="odd, got 8"):
        frames_with_whole_window(COUNT, FACTOR, 8)


@pytest.mark.parametrize("averaging_space", ["srgb", "linear"])
@pytest.mark.parametrize("window", [1, 5, 9, 17])
def test_running_sums_equal_the_mean_of_each_window(averaging_space, window):
    images = pictures(FACTOR * (COUNT - 1) + 1)
    kept = frames_with_whole_window(COUNT, FACTOR, window)
    blurred = windows(images, COUNT, window, averaging_space)
    assert len(blurred) == len(kept)
    for frame, picture in zip(kept, blurred, strict=True):
        inside = images[frame * FACTOR - window // 2 : frame * FACTOR + window // 2 + 1]
        mean = expose(torch.from_numpy(np.stack(inside)).double() / 255, averaging_space) * 255
        assert len(inside) == window
        assert np.abs(picture - mean.numpy()).max() <= 0.5 + 1e-6


@pytest.mark.parametrize("averaging_space", ["srgb", "linear"])
def test_one_sub_frame_is_the_frame_itself(averaging_space):
    images = pictures(FACTOR * (COUNT - 1) + 1, depth=4)
    assert np.array_equal(windows(images, COUNT, 1, averaging_space), images[::FACTOR])


def test_a_matte_is_averaged_as_coverage_in_either_light():
    images = pictures(FACTOR * (COUNT - 1) + 1, depth=4)
    in_srgb, in_linear = (
        windows(images, COUNT, 9, averaging_space) for averaging_space in ("srgb", "linear")
    )
    assert np.array_equal(np.stack(in_srgb)[..., 3], np.stack(in_linear)[..., 3])
    assert (np.stack(in_srgb)[..., :3] < np.stack(in_linear)[..., :3]).mean() > 0.9


def test_few_running_sums_are_held_however_long_the_clip_is():
    alive: list[int] = []
    stream = blur_windows(iter(pictures(401)), 101, FACTOR, 9, "srgb")
    next(stream)
    for _ in stream:
        assert stream.gi_frame is not None
        alive.append(len(stream.gi_frame.f_locals["open_totals"]))
    assert max(alive) <= 9 / FACTOR + 2


def test_a_training_exposure_ends_before_the_held_out_part_begins():
    timestamps = torch.arange(10) / 60.0
    # 33 sub-frames at 480 a second reach two frames: frames 5 and 6 look into frame 7 and 8.
    assert frames_before(timestamps, 33 / 480, float(timestamps[7])) == (0, 1, 2, 3, 4)
    assert frames_before(timestamps, None, float(timestamps[7])) == tuple(range(7))
