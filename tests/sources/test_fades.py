"""Footage that fades in and out is read without its fades."""

import numpy as np
import pytest
import torch

from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.fades import DIP, PAUSE, longest_without_fades
from deblur_avatar.sources.footage import check_readable, read_footage
from tests.sources.small_videos import FPS, write_video
from tests.sources.test_shots import place, shot

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


@pytest.mark.parametrize("blank", [0, 1, 2])
@pytest.mark.parametrize("length", [4, 12])
@pytest.mark.parametrize(("other", "joined"), [(1, False), (0, True)])
def test_fades_that_meet_are_between_two_places(blank, length, other, joined):
    """But where it grows dark and light again in one place, that is one recording."""
    fade = into(length)
    dark = [*fade[::-1], *[0.0] * blank, *fade]
    shares = [*[1.0] * 20, *dark, *[1.0] * 30]
    after = len(fade) + 30
    frames = [*shot(0, len(shares) - after, step=1), *shot(other, after, step=1)]
    random = np.random.default_rng(0)
    noisy = [
        (frame + random.normal(0, 3, frame.shape)).clip(0, 255).astype(np.uint8)
        for frame in faded(frames, shares)
    ]
    first, stop = part(noisy)
    assert stop == len(shares)
    assert first == (0 if joined else pytest.approx(20 + len(dark), abs=1))


@pytest.mark.parametrize("beside", [0.6, 1.0])
def test_one_dark_frame_between_bright_ones_is_a_mistake(beside):
    frames = [*shot(0, 20), *shot(1, 31)]
    shares = [1.0] * 19 + [beside, 0.1, beside] + [1.0] * 29
    assert part(faded(frames, shares)) == (0, 51)


@pytest.mark.parametrize("whole", [5, 6])
@pytest.mark.parametrize("first_one", [False, True])
def test_beside_fades_that_meet_something_is_seen_for_a_while(whole, first_one):
    fade = into(4)
    shares = [1.0] * whole + fade[::-1] + fade + [1.0] * 30
    frames = [*shot(0, whole + 4, step=1), *shot(1, 34, step=1)]
    shown = faded(frames, shares)
    parted = (whole + 8, len(shares)) if whole == 6 else (0, len(shares))
    found = part(shown if first_one else shown[::-1])
    assert found == (parted if first_one else (0, parted[1] - parted[0]))


def test_a_pause_within_a_dip_is_left_out_with_it():
    shares = [1.0] * 20 + [0.6, 0.3, 0.1, 0.1, 0, 0, 0] + [0.1] * 12 + [0.3, 0.6] + [1.0] * 40
    frames = [*shot(0, 26, step=1), *shot(1, len(shares) - 26, step=1)]
    first, stop = part(faded(frames, shares))
    assert first == pytest.approx(41, abs=1)
    assert stop == len(shares)


def test_a_pan_past_a_bare_wall_is_one_recording():
    """Its contrast falls and rises as that of fades does."""
    random = np.random.default_rng(0)
    wide = place(7, 6 * 192)
    wide[:, 480:680] = 120 + random.normal(0, 4, wide[:, 480:680].shape)
    frames = [
        (wide[:, left : left + 192] + random.normal(0, 2, (108, 192, 3))).clip(0, 255)
        for left in range(0, 960, 10)
    ]
    contrast = [float(frame.mean(2).std()) for frame in frames]
    assert min(contrast) < DIP * np.median(contrast)
    assert part([frame.astype(np.uint8) for frame in frames]) == (0, 96)


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
