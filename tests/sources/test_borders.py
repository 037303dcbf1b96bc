import numpy as np
import pytest
import torch

from deblur_avatar.sources.borders import picture_inside, without_borders
from deblur_avatar.sources.footage import Footage

HEIGHT, WIDTH, COUNT = 72, 96, 10
RANDOM = np.random.default_rng(0)


def scene(height: int = HEIGHT, width: int = WIDTH, dark: int = 0) -> np.ndarray:
    """Something everywhere, and somebody bright who goes through it; `dark` of 255 are missing."""
    still = RANDOM.integers(20, 120, (height, width, 3)).astype(np.int16)
    frames = np.repeat(still[None], COUNT, 0) - dark
    for index in range(COUNT):
        frames[index, 10:60, 10 + 6 * index : 24 + 6 * index] = 200
    return frames.clip(0, 255).astype(np.uint8)


def framed(
    frames: np.ndarray, above: int, below: int, left: int, right: int, colour: int = 0
) -> torch.Tensor:
    """With bars as a codec leaves them: some levels off."""
    pads = ((0, 0), (above, below), (left, right), (0, 0))
    whole = np.pad(frames.astype(np.int16), pads, constant_values=colour)
    noise = RANDOM.integers(-3, 4, whole.shape)
    return torch.from_numpy((whole + noise).clip(0, 255).astype(np.uint8))


@pytest.mark.parametrize("colour", [0, 16, 128, 255])
@pytest.mark.parametrize(
    "bars", [(12, 12, 0, 0), (0, 0, 30, 30), (12, 11, 20, 21), (60, 60, 120, 120)]
)
def test_bars_of_one_colour_are_found(bars, colour):
    above, _, left, _ = bars
    found = picture_inside(framed(scene(), *bars, colour))
    assert found == (left, above, WIDTH, HEIGHT)


def test_a_smeared_edge_goes_with_the_bar():
    frames = framed(scene(), 12, 12, 0, 0)
    frames[:, 11, :30] = 60
    frames[:, 84, 50:70] = 60
    assert picture_inside(frames) == (0, 12, WIDTH, HEIGHT)


@pytest.mark.parametrize("bars", [(12, 0, 0, 0), (12, 20, 0, 0), (0, 0, 0, 30), (1, 1, 1, 1)])
def test_bars_on_one_side_and_spoilt_lines_are_the_cameras(bars):
    frames = framed(scene(), *bars)
    assert picture_inside(frames) == (0, 0, frames.shape[2], frames.shape[1])


@pytest.mark.parametrize("wall", [0, 255])
def test_somebody_before_one_colour_is_no_picture_with_bars(wall):
    frames = torch.full((2, 288, 384, 3), wall, dtype=torch.uint8)
    for row in range(60, 230):  # a trunk that widens downwards, as far from left as from right
        half = 40 + (row - 60) // 10
        frames[:, row, 192 - half : 192 + half] = 120
    assert picture_inside(frames) == (0, 0, 384, 288)


def test_somebody_thin_in_the_dark_is_no_picture_with_bars():
    frames = torch.zeros(8, 144, 192, 3, dtype=torch.uint8)
    frames[:, 20:140, 90:102] = 120
    assert picture_inside(frames) == (0, 0, 192, 144)
    wide = torch.zeros(8, 144, 192, 3, dtype=torch.uint8)
    wide[:, :, 68:124] = 120
    assert picture_inside(wide) == (68, 0, 56, 144)


def test_one_colour_all_over_has_no_bars():
    assert picture_inside(torch.zeros(3, 20, 30, 3, dtype=torch.uint8)) == (0, 0, 30, 20)


def test_a_night_inside_bars_is_found_once_anything_shows():
    night = framed(scene(dark=30), 12, 12, 0, 0)
    assert picture_inside(night) == (0, 12, WIDTH, HEIGHT)


def test_the_recorded_size_is_the_pictures(caplog: pytest.LogCaptureFixture):
    frames = framed(scene(), 12, 12, 0, 0)
    read = Footage(frames, torch.arange(COUNT).double(), tuple(range(COUNT)), COUNT, (192, 192))
    cut = without_borders(read, "a.mp4")
    assert torch.equal(cut.frames, frames[:, 12 : 12 + HEIGHT])
    assert cut.recorded_size == (192, 144)
    assert (cut.timestamps is read.timestamps, cut.numbers) == (True, read.numbers)
    assert "a.mp4: bars are cut off, the picture is 192 x 144 of 192 x 192" in caplog.text
    assert without_borders(cut, "a.mp4") is cut
