from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from deblur_avatar.sources.footage import read_footage
from deblur_avatar.sources.shots import SAME_PLACE, _detail, longest_shot, shot_starts
from tests.sources.small_videos import FPS, write_video

WIDTH, HEIGHT = 192, 108


def place(seed: int, width: int = WIDTH) -> np.ndarray:
    """A place with colours of its own, blurred as backgrounds are."""
    random = np.random.default_rng(seed)
    colours = random.uniform(20, 235, (9, 2 * width // WIDTH * 8, 3)).astype(np.float32)
    return cv2.resize(colours, (width, HEIGHT), interpolation=cv2.INTER_CUBIC).clip(0, 255)


def shot(seed: int, count: int, step: float = 4) -> list[np.ndarray]:
    """Someone in white walks through a place, and the sensor has noise."""
    random, frames = np.random.default_rng(seed), []
    for index in range(count):
        frame = place(seed) + random.normal(0, 3, (HEIGHT, WIDTH, 3))
        left = int(10 + step * index) % (WIDTH - 30)
        frame[15:100, left : left + 24] = 240
        frames.append(frame.clip(0, 255).astype(np.uint8))
    return frames


def pan(count: int, step: int, first: int = 0) -> list[np.ndarray]:
    wide = place(7, 6 * WIDTH).astype(np.uint8)
    lefts = (max(0, i - first) * step for i in range(count))
    return [wide[:, left : left + WIDTH] for left in lefts]


def starts(frames: list[np.ndarray]) -> list[int]:
    return shot_starts(torch.from_numpy(np.stack(frames)))


def test_cuts_are_found_where_they_are():
    frames = [*shot(0, 20), *shot(1, 30), *shot(2, 12)]
    assert starts(frames) == [0, 20, 50]
    assert longest_shot([0, 20, 50], 62) == (20, 50)


@pytest.mark.parametrize("left", [1, 2, 3])
def test_what_an_editor_left_of_another_shot_is_found(left: int):
    assert starts([*shot(0, left), *shot(1, 20)]) == [0, left]
    assert starts([*shot(0, 20), *shot(1, left)]) == [0, 20]


def test_a_glimpse_of_something_else_does_not_join_two_shots():
    assert starts([*shot(0, 15), *shot(1, 2), *shot(2, 15)])[1] in (15, 17)


def captioned(frames: list[np.ndarray], seed: int) -> list[np.ndarray]:
    """A place with leaves, and an editor's words over its upper third, the same in all shots."""
    words = np.random.default_rng(9).integers(0, 2, (12, 48, 1)) * 255.0
    caption = np.repeat(np.repeat(words, 3, 0), 4, 1).repeat(3, 2)
    leaves = np.random.default_rng(seed).normal(0, 25, (HEIGHT // 2, WIDTH // 2, 1))
    leaves = np.repeat(np.repeat(leaves, 2, 0), 2, 1)[36:]
    return [
        np.concatenate([caption, frame[36:] + leaves]).clip(0, 255).astype(np.uint8)
        for frame in frames
    ]


def test_a_caption_over_two_shots_does_not_join_them():
    """Nor does it cut one in whose light something changes."""
    two = [*captioned(shot(0, 20), 0), *captioned(shot(1, 20), 1)]
    before, after = (_detail(picture) for picture in two[19:21])
    assert float((before * after).sum()) > SAME_PLACE
    assert starts(two) == [0, 20]
    assert starts(captioned(lamp(), 0)) == [0]


def flash() -> list[np.ndarray]:
    frames = shot(0, 30)
    frames[12] = np.full_like(frames[12], 250)
    return frames


def drift() -> list[np.ndarray]:
    return [(f * (1 - 0.02 * i)).astype(np.uint8) for i, f in enumerate(shot(0, 30))]


def lamp() -> list[np.ndarray]:
    """Someone switches it on, and it stays on."""
    frames = shot(0, 30)
    return [*(f // 3 for f in frames[:15]), *frames[15:]]


def sun() -> list[np.ndarray]:
    """It shines into the lens from one side, until someone is in front of it."""
    veil = np.linspace(140, 0, WIDTH)[:, None] * (1.0, 0.8, 0.5)
    frames = shot(0, 30)
    veiled = [(0.5 * f + veil).clip(0, 255).astype(np.uint8) for f in frames[:15]]
    return [*veiled, *frames[15:]]


def dusk() -> list[np.ndarray]:
    """Before a bare wall, where most of what is told is noise, a lamp goes on."""
    random, wall = np.random.default_rng(0), np.full((HEIGHT, WIDTH, 3), 60, np.float32)
    wall[20:64, 120:170] = random.uniform(20, 110, (44, 50, 1))
    lit = [wall] * 15 + [1.8 * wall] * 15
    return [
        (f + random.normal(0, 1.5, (HEIGHT, WIDTH, 1))).clip(0, 255).astype(np.uint8) for f in lit
    ]


@pytest.mark.parametrize(
    "frames",
    [
        *(shot(0, 30), shot(0, 30, step=25), pan(30, 20), pan(30, 30)),
        *(flash(), lamp(), sun(), dusk(), drift(), shot(0, 2)),
    ],
    ids=["walk", "run", "pan", "whip", "flash", "lamp", "sun", "dusk", "exposure", "two_frames"],
)
def test_one_recording_is_one_shot(frames: list[np.ndarray]):
    assert starts(frames) == [0]


def test_the_longest_of_equals_is_the_first():
    assert longest_shot([0, 10, 20], 30) == (0, 10)
    assert longest_shot([0], 7) == (0, 7)


def test_footage_is_the_longest_shot_and_its_numbers_are_the_files(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    path = write_video(tmp_path / "edited.mp4", [*shot(0, 8), *shot(1, 20), *shot(2, 6)])
    footage = read_footage(path, (0, None), 1, 30.0, HEIGHT)
    assert footage.numbers == tuple(range(8, 28))
    assert footage.total == 34
    assert footage.timestamps.tolist() == pytest.approx([n / FPS for n in footage.numbers])
    assert "3 shots, cut before frames 8, 28; taken is the longest, frames 8 to 27" in caplog.text


@pytest.mark.parametrize("times", [2, 3])
def test_a_picture_that_comes_several_times_makes_no_cut_of_the_next(tmp_path: Path, times: int):
    frames = [frame for frame in pan(24, 30) for _ in range(times)]
    assert len(starts(frames)) > 1  # beside copies every step looks like a cut
    footage = read_footage(write_video(tmp_path / "c.mp4", frames), (0, None), 1, 30.0, HEIGHT)
    assert len(footage.frames) == 24


def test_another_shot_is_taken_by_the_frames_asked_for(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    path = write_video(tmp_path / "edited.mp4", [*shot(0, 8), *shot(1, 20)])
    assert read_footage(path, (0, 8), 1, 30.0, HEIGHT).numbers == tuple(range(8))
    assert "shots" not in caplog.text
