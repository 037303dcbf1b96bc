"""Files as users have them, each written with its damage and read as one's own video."""

import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear
from deblur_avatar.pipeline.blur import BlurParams, blur
from deblur_avatar.sources.footage import read_footage
from deblur_avatar.sources.footage_damage import conversion, light_drift, repeated_frames
from deblur_avatar.sources.monocular import load_monocular
from deblur_avatar.sources.studio.sensor import expose_rows
from tests.sources.small_videos import held_otherwise
from tests.sources.test_monocular import nobody_asks, params

WIDTH, HEIGHT, TICKS = 192, 108, 90000


def room() -> np.ndarray:
    """A textured wall."""
    grid = np.random.default_rng(0).uniform(40, 200, (14, 24, 3)).astype(np.float32)
    wide = cv2.resize(grid, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return np.asarray(wide.clip(20, 220))


def walker(count: int, step: float = 2.5, shift: float = 0.0) -> list[np.ndarray]:
    """Someone in grey who walks before the wall, four moments of standing still left out."""
    frames = []
    for index in range(count):
        frame = room()
        left = 20 + step * index + shift
        for x in range(WIDTH):
            share = np.clip(min(x + 1 - left, left + 24 - x), 0, 1)
            frame[20:100, x] = (1 - share) * frame[20:100, x] + share * 90
        frames.append(frame)
    return frames


def noisy(frames: list[np.ndarray], deviation: float) -> list[np.ndarray]:
    random = np.random.default_rng(1)
    return [frame + random.normal(0, deviation, frame.shape) for frame in frames]


def write(
    path: Path,
    frames: list[np.ndarray],
    seconds: list[float] | None = None,
    fps: float = 30.0,
    quality: int = 23,
    preset: str = "medium",
) -> Path:
    """Encode as phones do: H.264 with B frames and half the colour, with loss.

    Of the same codes x264 writes another file now and then, even with one thread (decision 78):
    what a test says must hold of all such files.
    """
    seconds = seconds or [index / fps for index in range(len(frames))]
    with av.open(str(path), "w") as container:
        options = {"crf": str(quality), "threads": "1", "preset": preset}
        stream = container.add_stream("libx264", rate=round(fps), options=options)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, TICKS)
        for image, time in zip(frames, seconds, strict=True):
            codes = np.rint(image.clip(0, 255)).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(codes, format="rgb24")
            frame.pts, frame.time_base = round(time * TICKS), Fraction(1, TICKS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def load(body: Body, path: Path, **changes: object) -> Clip:
    asked = params(path, **({"image_height": HEIGHT} | changes))
    return load_monocular(asked, body, nobody_asks)[0]


def converted(frames: list[np.ndarray]) -> list[np.ndarray]:
    """24 frames a second in a file of 30: the last of every four comes twice."""
    return [frame for i, frame in enumerate(frames) for _ in range(2 if i % 4 == 3 else 1)]


@pytest.mark.parametrize("deviation", [0.0, 4.0])
@pytest.mark.parametrize("quality", [18, 28])
def test_24_frames_in_30_are_24_evenly_spaced_frames_again(
    body: Body, tmp_path: Path, caplog: pytest.LogCaptureFixture, deviation: float, quality: int
):
    path = write(tmp_path / "a.mp4", converted(noisy(walker(24), deviation)), quality=quality)
    clip = load(body, path)
    assert clip.frames.shape[1] == 24
    assert clip.timestamps.diff().tolist() == pytest.approx([1 / 24] * 23, abs=1e-4)
    assert clip.exposure == pytest.approx(0.5 / 24, rel=1e-3)
    assert "6 repeated frames left out: 4, 9, 14, 19, 24, 29" in caplog.text
    assert "every 5. frame repeats the one before" in caplog.text


def shown(frames: list[np.ndarray], times: list[int]) -> list[np.ndarray]:
    """Each picture as often as a converted rate shows it, `times` over and over."""
    return [frame for i, frame in enumerate(frames) for _ in range(times[i % len(times)])]


CONVERTED = {
    "15 in 30": ([2], 30, 15, 0.0, "every 2. frame repeats"),
    "10 in 30": ([3], 30, 10, 0.0, "2 of 3 frames repeat"),
    "20 in 30": ([1, 2], 30, 20, 0.0, "every 3. frame repeats"),
    "18 in 30": ([2, 1, 2], 30, 18, 0.0, "2 of 5 frames repeat"),
    "30 in 60, noisy": ([2], 60, 30, 2.0, "every 2. frame repeats"),
    "20 in 60": ([3], 60, 20, 0.0, "2 of 3 frames repeat"),
    "20 in 60, noisy": ([3], 60, 20, 2.0, "2 of 3 frames repeat"),
    "24 in 60": ([2, 3], 60, 24, 0.0, "3 of 5 frames repeat"),
    "24 in 60, noisy": ([2, 3], 60, 24, 4.0, "3 of 5 frames repeat"),
    "25 in 60": ([3, 2, 2, 3, 2], 60, 25, 0.0, "7 of 12 frames repeat"),
    "10 in 60": ([6], 60, 10, 2.0, "5 of 6 frames repeat"),
}


@pytest.mark.parametrize("case", CONVERTED)
def test_a_converted_rate_is_undone_however_often_a_picture_comes(
    body: Body, tmp_path: Path, caplog: pytest.LogCaptureFixture, case: str
):
    times, rate, taken, deviation, said = CONVERTED[case]
    frames = shown(noisy(walker(20, step=1.5), deviation), times)
    clip = load(body, write(tmp_path / "a.mp4", frames, fps=rate))
    assert clip.frames.shape[1] == 20
    assert clip.timestamps.tolist() == pytest.approx([i / taken for i in range(20)], abs=1e-3)
    assert clip.exposure == pytest.approx(0.5 / taken, rel=1e-3)
    assert f"{said} the one before, so its frame rate was converted" in caplog.text


@pytest.mark.parametrize("stride", [2, 3])
def test_a_stride_that_still_meets_copies_leaves_the_camera_s_interval(
    body: Body, tmp_path: Path, stride: int
):
    path = write(tmp_path / "a.mp4", shown(walker(16), [4]), fps=60)
    clip = load(body, path, stride=stride)
    assert clip.frames.shape[1] == 16
    assert clip.timestamps.diff().tolist() == pytest.approx([1 / 15] * 15, abs=1e-3)
    assert clip.exposure == pytest.approx(0.5 / 15, rel=1e-3)


def test_a_conversion_that_slips_keeps_the_container_s_times_and_the_camera_s_interval(
    body: Body, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    frames = shown(walker(16), [2])
    del frames[15]
    clip = load(body, write(tmp_path / "a.mp4", frames))
    times = [(2 * index - (index > 7)) / 30 for index in range(16)]
    assert clip.timestamps.tolist() == pytest.approx(times, abs=1e-4)
    assert clip.exposure == pytest.approx(0.5 / 15, rel=1e-3)
    assert "converted" not in caplog.text


def test_a_still_second_of_a_converted_rate_does_not_hide_it(body: Body, tmp_path: Path):
    walked = walker(12)
    frames = noisy([*walked, *[walked[-1]] * 10, *walker(12, shift=30.0)], 2.0)
    clip = load(body, write(tmp_path / "a.mp4", shown(frames, [3]), quality=18))
    assert clip.frames.shape[1] == 34
    assert clip.exposure == pytest.approx(0.5 / 10, rel=1e-3)


def test_a_single_repeat_leaves_the_times_of_the_others_alone(
    body: Body, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    frames = walker(12)
    clip = load(body, write(tmp_path / "a.mp4", [*frames[:5], frames[4], *frames[5:]]))
    times = [index / 30 for index in range(13) if index != 5]
    assert clip.timestamps.tolist() == pytest.approx(times, abs=1e-4)
    assert "1 repeated frames left out: 5" in caplog.text
    assert "converted" not in caplog.text


@pytest.mark.parametrize("deviation", [0.0, 4.0])
def test_someone_who_stands_still_for_a_while_is_not_left_out(
    body: Body, tmp_path: Path, deviation: float
):
    walked = walker(8)
    frames = noisy([*walked, *[walked[-1]] * 6, *walker(8, shift=20.0)], deviation)
    path = write(tmp_path / "a.mp4", frames)
    kept = load(body, path).frames.shape[1]
    # Without noise an encoder may repeat to the last bit what stands perfectly still.
    assert kept == 22 if deviation else kept >= 16


@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_a_still_second_keeps_its_frames_and_the_exposure(
    body: Body, tmp_path: Path, caplog: pytest.LogCaptureFixture, fps: float
):
    walked, still = walker(16, step=1.0), round(fps)
    frames = noisy([*walked, *[walked[-1]] * still, *walker(16, step=1.0, shift=16.0)], 4.0)
    # Were more lost, some frames would be the same as those before them in some files.
    clip = load(body, write(tmp_path / "a.mp4", frames, fps=fps, quality=18))
    assert clip.frames.shape[1] == 32 + still
    assert clip.exposure == pytest.approx(0.5 / fps, rel=1e-3)
    assert "repeated" not in caplog.text


@pytest.mark.parametrize("step", [0.2, 0.5])
@pytest.mark.parametrize("quality", [18, 28])
def test_slow_motion_is_no_conversion(body: Body, tmp_path: Path, step: float, quality: int):
    frames = noisy(walker(48, step=step), 1.0)
    clip = load(body, write(tmp_path / "a.mp4", frames, quality=quality))
    assert clip.frames.shape[1] == 48
    assert clip.exposure == pytest.approx(0.5 / 30, rel=1e-3)


def test_a_frame_that_was_dropped_is_a_gap_that_is_told(
    body: Body, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    frames = walker(12)
    kept = [index for index in range(12) if index not in (5, 6)]
    clip = load(body, write(tmp_path / "a.mp4", [frames[i] for i in kept], [i / 30 for i in kept]))
    assert clip.timestamps.tolist() == pytest.approx([i / 30 for i in kept], abs=1e-4)
    assert clip.exposure == pytest.approx(0.5 / 30, rel=1e-3)
    assert "1 gaps in time, after frames 4" in caplog.text


def test_a_variable_frame_rate_keeps_the_camera_s_own_times(body: Body, tmp_path: Path):
    steps = np.array([33, 34, 41, 29, 33, 36, 52, 31, 33, 30, 38]) / 1000
    seconds = [0.0, *np.cumsum(steps).tolist()]
    clip = load(body, write(tmp_path / "a.mp4", walker(12), seconds))
    assert clip.timestamps.tolist() == pytest.approx(seconds, abs=1e-4)
    assert clip.exposure == pytest.approx(0.5 * 0.033, rel=0.05)


@pytest.mark.parametrize("rotation", [90, -90, 180])
def test_a_portrait_recording_stands_upright(body: Body, tmp_path: Path, rotation: int):
    recording = write(tmp_path / "a.mp4", walker(4))
    plain = load(body, recording, image_height=1000)
    other = held_otherwise(tmp_path / "b.mp4", recording, rotation)
    turned = load(body, other, image_height=1000)
    upright = torch.rot90(plain.frames, round(rotation / 90) % 4, (2, 3))
    assert (turned.frames.int() - upright.int()).abs().max() <= 2
    width, height = turned.frames.shape[3], turned.frames.shape[2]
    assert turned.cameras.sizes.tolist() == [[width, height]]
    assert turned.cameras.Ks[0, :2, 2].tolist() == [width / 2, height / 2]
    assert turned.cameras.Ks[0, 0, 0] == plain.cameras.Ks[0, 0, 0]  # of the longer side


def test_frames_keep_the_numbers_of_their_file_where_some_were_left_out(body: Body, tmp_path: Path):
    """What is said of frames later is what clip.frames counts."""
    path = write(tmp_path / "a.mp4", converted(walker(24)))
    whole = load(body, path)
    assert whole.numbered([3, 4, 23]) == (3, 5, 28)
    assert load(body, path, frames=(5, 15)).numbered(range(8)) == (5, 6, 7, 8, 10, 11, 12, 13)
    plain = load(body, write(tmp_path / "b.mp4", walker(8)))
    assert (plain.numbers, plain.numbered([7])) == (None, (7,))
    params = BlurParams(frames="interpolated", factor=8, window=33, averaging_space="linear")
    passed = blur(whole, params)
    assert passed.frame_indices == whole.numbers


@pytest.mark.parametrize("quality", [18, 28])
@pytest.mark.parametrize("masked", [False, True])
def test_bars_are_cut_off_unless_masks_came_along_that_have_them_too(
    body: Body, tmp_path: Path, quality: int, masked: bool
):
    frames = [np.pad(frame, ((42, 42), (0, 0), (0, 0))) for frame in walker(8)]
    video, masks = write(tmp_path / "a.mp4", frames, quality=quality), tmp_path / "masks"
    if masked:
        masks.mkdir()
        for index in range(8):
            mask = np.zeros((HEIGHT + 84, WIDTH), np.uint8)
            mask[62:142, 20:44] = 255
            cv2.imwrite(str(masks / f"{index}.png"), mask)
    clip = load(body, video, image_height=1000, masks=str(masks) if masked else None)
    ((width, height),) = clip.cameras.sizes.tolist()
    assert (width, height) == (WIDTH, HEIGHT + 84 if masked else HEIGHT)
    assert clip.cameras.Ks[0, :2, 2].tolist() == [width / 2, height / 2]


@pytest.mark.parametrize("quality", [18, 38])
def test_what_an_encoder_lost_stays_within_what_it_lost(body: Body, tmp_path: Path, quality: int):
    frames = walker(8)
    read = load(body, write(tmp_path / "a.mp4", frames, quality=quality)).frames[0]
    assert len(read) == 8
    away = (read.float() - torch.from_numpy(np.stack(frames))).abs()
    # Half of the colour goes with any H.264; its mean stays.
    assert away.mean() < (6 if quality == 18 else 12)
    means = read.float().mean((0, 1, 2)), torch.from_numpy(np.stack(frames)).mean((0, 1, 2))
    assert (means[0] - means[1]).abs().max() < 2


def test_noise_neither_repeats_nor_brightens_frames(body: Body, tmp_path: Path):
    clip = load(body, write(tmp_path / "a.mp4", noisy(walker(12), 12.0)))
    assert clip.frames.shape[1] == 12
    assert float(clip.frames.float().mean()) == pytest.approx(np.mean(walker(12)), abs=2)


def drifted(frames: list[np.ndarray], stops: np.ndarray) -> list[np.ndarray]:
    """The same light under another exposure a frame: [F, 3] stops."""
    light = srgb_to_linear(torch.from_numpy(np.stack(frames)) / 255)
    light = light * 2.0 ** torch.from_numpy(stops)[:, None, None]
    return list((linear_to_srgb(light.clamp(0, 1)) * 255).numpy())


@pytest.mark.parametrize("moving", [False, True])
def test_an_exposure_that_drifts_is_told_in_stops(
    body: Body, tmp_path: Path, caplog: pytest.LogCaptureFixture, moving: bool
):
    frames = walker(16)
    if moving:
        frames = [np.roll(frame, index, axis=1) for index, frame in enumerate(frames)]
    stops = np.linspace(0, 0.6, 16)[:, None] * np.array([1.0, 1.0, 0.5])
    read = load(body, write(tmp_path / "a.mp4", noisy(drifted(frames, stops), 2.0)))
    assert light_drift(read.frames[0]) == pytest.approx([0.6, 0.6, 0.3], abs=0.12)
    assert "the camera's exposure or white balance drifts" in caplog.text
    assert "exposure_gain: frame" in caplog.text


def test_a_locked_exposure_is_not_called_adrift(
    body: Body, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    load(body, write(tmp_path / "a.mp4", noisy(walker(16), 6.0)))
    assert "drifts" not in caplog.text


def test_a_rolling_shutter_leans_what_moves_about_the_middle_row_of_each_frame(
    body: Body, tmp_path: Path
):
    instants = [np.stack(walker(9, shift=10.0 * frame)) for frame in range(5)]
    frames = [expose_rows(torch.from_numpy(seen), 1).numpy() for seen in instants]
    read = load(body, write(tmp_path / "a.mp4", frames, quality=10)).frames[0]
    assert len(read) == 5
    seen = torch.from_numpy(instants[2])
    # The row in the middle is of the middle instant, one above and one below of others.
    for row, instant in ((HEIGHT // 2, 4), (24, 2), (96, 7)):
        away = [float((read[2, row].float() - moment[row]).abs().mean()) for moment in seen]
        assert int(np.argmin(away)) == instant


def test_4k_is_scaled_down_as_it_is_read(tmp_path: Path):
    count, large = 40, (2160, 3840)
    frames = [
        cv2.resize(frame.astype(np.float32), large[::-1], interpolation=cv2.INTER_NEAREST)
        for frame in walker(2)
    ]
    shown = [frames[index % 2] for index in range(count)]
    path = write(tmp_path / "a.mp4", shown, quality=35, preset="superfast")
    program = (
        "import re, sys; from pathlib import Path;"
        "from deblur_avatar.sources.footage import read_footage;"
        "said = Path('/proc/self/status');"  # `ru_maxrss` begins with the starting process's peak
        "peak = lambda: int(re.search(r'VmHWM:\\s*(\\d+)', said.read_text())[1]) / 1024;"
        "before = peak(); f = read_footage(Path(sys.argv[1]), (0, None), 1, 30.0, 540);"
        "print(tuple(f.frames.shape), f.recorded_size, peak() - before)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)], capture_output=True, text=True, check=True
    )
    shape, grown = done.stdout.rsplit(" ", 1)
    assert shape == "(40, 540, 960, 3) (3840, 2160)"
    # All frames at full size are 995 MB; a decoder alone holds a dozen of half that size each.
    assert float(grown) < 700


def test_repeats_are_found_where_only_a_person_moves_and_all_else_is_still(tmp_path: Path):
    path = write(tmp_path / "a.mp4", converted(walker(16, step=0.6)), quality=20)
    assert read_footage(path, (0, None), 1, 30.0, HEIGHT).numbers[:6] == (0, 1, 2, 3, 5, 6)


def test_repeats_without_an_even_pattern_are_no_conversion():
    frozen = [index for start in range(0, 36, 6) for index in range(start + 3, start + 6)]
    assert conversion(frozen, 36) is None  # three pictures, then three copies
    assert conversion([5, 20, 21], 36) is None
    assert conversion([], 36) is None
    assert conversion(list(range(1, 36)), 36) is None
    assert conversion([index for index in range(36) if index % 5 in (1, 3, 4)], 36) == Fraction(
        2, 5
    )


def test_frames_of_one_picture_are_all_repeats():
    still = torch.from_numpy(room().astype(np.uint8)).expand(5, HEIGHT, WIDTH, 3)
    assert repeated_frames(still) == [1, 2, 3, 4]
