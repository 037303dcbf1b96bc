"""Footage that fades in and out is read without its fades."""

import numpy as np
import pytest
import torch

from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.fades import PAUSE, longest_without_fades
from deblur_avatar.sources.footage import check_readable, read_footage
from tests.sources.small_videos import FPS, write_video
from tests.sources.test_shots import shot

BLACK, WHITE = 0.0, 255.0


def faded(frames, shares, color=BLACK):
    """Each frame as much of itself as is said, the rest of one colour."""
    return [
        np.rint(color + share * (frame - color)).astype(np.uint8)
        for frame, share in zip(frames, shares, strict=True)
    ]


def part(frames):
    return longest_without_fades(torch.from_numpy(np.stack(frames)))


def into(count, blank=0):
    """Shares of a fade in, after so many blank frames."""
    return [0.0] * blank + [(index + 0.5) / count for index in range(count)]


@pytest.mark.parametrize("color", [BLACK, WHITE, 90.0])
@pytest.mark.parametrize("length", [4, 12, 40])
@pytest.mark.parametrize("blank", [1, 10])
def test_fades_at_both_ends_are_left_out(color, length, blank):
    fade = into(length, blank)
    shares = [*fade, *[1.0] * 40, *fade[::-1]]
    first, stop = part(faded(shot(0, len(shares), step=1), shares, color))
    whole = len(fade), len(fade) + 40
    assert first == pytest.approx(whole[0], abs=1 + length // 20)
    assert stop == pytest.approx(whole[1], abs=1 + length // 20)


def test_footage_without_blank_frames_is_whole():
    frames = shot(0, 40)
    assert part(frames) == (0, 40)
    assert part(faded(frames, np.linspace(0.2, 1.0, 40))) == (0, 40)  # somebody opens a curtain
    assert part([np.zeros_like(frames[0])] * 8) == (0, 8)


def test_blank_frames_without_a_fade_are_left_out():
    shares = [0.0] * 6 + [1.0] * 30 + [0.0] * 5
    assert part(faded(shot(0, 41), shares)) == (6, 36)


@pytest.mark.parametrize("blank", [PAUSE - 1, PAUSE])
def test_between_two_recordings_it_is_dark_for_longer_than_by_mistake(blank):
    shares = [1.0] * 20 + [0.0] * blank + [1.0] * 30
    found = part(faded([*shot(0, 20), *shot(1, 30 + blank)], shares))
    assert found == ((20 + blank, 50 + blank) if blank == PAUSE else (0, 50 + blank))


def test_the_longest_of_several_parts_is_taken_without_its_own_fades():
    fade = into(10, blank=4)
    shares = [1.0] * 15 + fade[::-1] + fade + [1.0] * 40 + fade[::-1] + [1.0] * 20
    first, stop = part(faded(shot(0, len(shares), step=1), shares))
    assert first == pytest.approx(15 + 2 * len(fade), abs=1)
    assert stop == pytest.approx(15 + 2 * len(fade) + 40, abs=1)


def test_a_part_that_is_nothing_but_a_fade_stays():
    shares = [0.0] * 4 + [0.3, 0.6, 1.0, 0.6, 0.3] + [0.0] * 4
    first, stop = part(faded(shot(0, len(shares), step=1), shares))
    assert first <= 6 < stop


def test_a_video_that_fades_out_is_read_to_where_it_does(tmp_path, caplog):
    shares = [1.0] * 30 + into(12, blank=8)[::-1]
    frames = faded(shot(0, len(shares)), shares)
    footage = read_footage(write_video(tmp_path / "a.mp4", frames), (0, None), 1, float(FPS), 1080)
    assert footage.numbers == tuple(range(len(footage.numbers)))
    assert 28 <= len(footage.numbers) <= 31
    assert len(footage.frames) == len(footage.timestamps) == len(footage.numbers)
    assert footage.total == len(shares)
    assert f"fades in or out; taken are frames 0 to {footage.numbers[-1]}" in caplog.text
    assert "drifts by" not in caplog.text
    assert "gaps in time" not in caplog.text


def test_a_video_that_begins_with_black_can_be_looked_at(tmp_path):
    frames = faded(shot(0, 20), [0.0] * 4 + [1.0] * 16)
    video = write_video(tmp_path / "a.mp4", frames)
    with pytest.raises(ArtifactError, match="shows 1 picture"):
        read_footage(video, (0, 2), 1, float(FPS), 1080)
    check_readable(video)
    assert read_footage(video, (0, None), 1, float(FPS), 1080).numbers[0] == 4
