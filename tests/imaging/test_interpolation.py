from fractions import Fraction

import cv2
import numpy as np
import pytest

from deblur_avatar.imaging.interpolation import (
    Flow,
    compare_flows,
    estimate_flow,
    interpolate,
    subframes,
)

pytestmark = pytest.mark.portable

SIZE = 96
HALF = Fraction(1, 2)


def texture(seed: int, height: int = SIZE, width: int = SIZE) -> np.ndarray:
    noise = np.random.default_rng(seed).uniform(0, 255, (height, width, 3))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    smooth = (smooth - smooth.min()) / (smooth.max() - smooth.min())
    return np.rint(255 * smooth).astype(np.uint8)


def disc(x: float) -> np.ndarray:
    """A textured disc with its matte, moved to column x in front of another texture."""
    shift = np.float32([[1, 0, x - SIZE / 2], [0, 1, 0]])
    rows, columns = np.mgrid[:SIZE, :SIZE]
    alpha = np.clip(20 - np.hypot(columns - x, rows - SIZE / 2), 0, 1)[..., None]
    front = cv2.warpAffine(texture(1), shift, (SIZE, SIZE), borderMode=cv2.BORDER_REFLECT)
    picture = alpha * front + (1 - alpha) * texture(2)
    return np.rint(np.dstack([picture, 255 * alpha])).astype(np.uint8)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / np.square(a.astype(float) - b).mean()))


def test_a_disc_is_drawn_where_it_is_between_two_frames():
    a, b = disc(40), disc(48)
    flow = estimate_flow(a, b)
    for step in (1, 2, 3):
        u = Fraction(step, 4)
        truth = disc(40 + 8 * float(u))
        drawn = interpolate(a, b, flow, u)
        mixed = cv2.addWeighted(a, 1 - float(u), b, float(u), 0)
        assert psnr(drawn[..., :3], truth[..., :3]) > psnr(mixed[..., :3], truth[..., :3]) + 5
        assert psnr(drawn[..., 3], truth[..., 3]) > psnr(mixed[..., 3], truth[..., 3]) + 2


def exact_flow(a: np.ndarray, b: np.ndarray, shift: float) -> Flow:
    there = np.where(a[..., 3:] > 0, np.float32([shift, 0]), np.float32(0))
    back = np.where(b[..., 3:] > 0, np.float32([-shift, 0]), np.float32(0))
    return compare_flows(there, back)


def test_background_that_one_frame_hides_is_taken_from_the_other():
    a, b, truth = disc(40), disc(52), disc(46)
    drawn = interpolate(a, b, exact_flow(a, b, 12), HALF)
    # The strips that the disc has just left (seen in b alone) or is about to cover (in a alone).
    hidden_once = (a[..., 3] > 250) ^ (b[..., 3] > 250)
    strip = hidden_once & (truth[..., 3] == 0)
    mixed = cv2.addWeighted(a, 0.5, b, 0.5, 0)
    assert strip.sum() > 100
    assert psnr(drawn[strip, :3], truth[strip, :3]) > psnr(mixed[strip, :3], truth[strip, :3]) + 10


def test_flow_is_in_pixels_from_the_first_frame_to_the_second():
    wide = texture(3, width=SIZE + 16)
    flow = estimate_flow(wide[:, 8 : SIZE + 8], wide[:, 5 : SIZE + 5])
    inside = (slice(16, -16), slice(16, -16))
    assert np.abs(flow.a_to_b[inside] - (3, 0)).max() < 0.3
    assert np.abs(flow.b_to_a[inside] - (-3, 0)).max() < 0.3
    assert flow.trust_a[inside].min() > 0.9


def test_real_frames_pass_through_unchanged():
    frames = [disc(40), disc(44), disc(50)]
    raised = list(subframes(iter(frames), 4))
    assert len(raised) == 9
    assert all(np.array_equal(raised[4 * index], frame) for index, frame in enumerate(frames))
    flow = estimate_flow(frames[0], frames[1])
    assert interpolate(frames[0], frames[1], flow, Fraction(0)) is frames[0]
    assert interpolate(frames[0], frames[1], flow, Fraction(1)) is frames[1]


def test_a_factor_of_one_adds_nothing():
    frames = [disc(40), disc(44)]
    assert all(a is b for a, b in zip(subframes(frames, 1), frames, strict=True))


def test_nothing_moves_in_a_still_clip():
    frame = disc(40)
    assert all(np.array_equal(picture, frame) for picture in subframes([frame, frame], 4))


def test_a_uniform_picture_stays_uniform():
    grey = np.full((SIZE, SIZE, 3), 90, np.uint8)
    black = np.zeros_like(grey)
    drawn = interpolate(black, grey, estimate_flow(black, grey), HALF)
    assert np.array_equal(drawn, np.full_like(grey, 45))


def test_running_time_backwards_shows_the_same_pictures():
    a, b = disc(40), disc(48)
    forward = interpolate(a, b, estimate_flow(a, b), Fraction(1, 4))
    backward = interpolate(b, a, estimate_flow(b, a), Fraction(3, 4))
    # One code: halves are rounded to even before and after the roles are swapped.
    assert np.abs(forward.astype(int) - backward).max() <= 1


def test_pictures_smaller_than_the_flows_pyramid_work():
    a, b = disc(40)[40:48, 30:36], disc(41)[40:48, 30:36]
    drawn = interpolate(a, b, estimate_flow(a, b), HALF)
    assert drawn.shape == (8, 6, 4)
    between = np.minimum(a, b).astype(int) - 40, np.maximum(a, b).astype(int) + 40
    assert (drawn >= between[0]).all()
    assert (drawn <= between[1]).all()


def test_a_time_outside_the_two_frames_is_refused():
    a, b = disc(40), disc(44)
    with pytest.raises(ValueError, match=r"u must be in \[0, 1\], got 3/2"):
        interpolate(a, b, estimate_flow(a, b), Fraction(3, 2))
