from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.video_files import read_video
from tests.sources.small_videos import held_otherwise

WIDTH, HEIGHT, COUNT, FPS = 48, 32, 6, 25


def picture(index: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """Left half red, the right half of a grey that counts frames."""
    image = np.full((height, width, 3), 40 * index + 20, np.uint8)
    image[:, : width // 2] = (200, 30, 30)
    return image


def write_video(path: Path) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=FPS)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.bit_rate = 4_000_000
        stream.time_base = Fraction(1, FPS)
        for index in range(COUNT):
            frame = av.VideoFrame.from_ndarray(picture(index), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def grey_of(frame: np.ndarray) -> float:
    return float(np.asarray(frame)[8:-8, -12:-4].mean())


def test_the_frames_asked_for_come_with_their_times(tmp_path: Path):
    video = read_video(write_video(tmp_path / "a.mp4"), 2, 5, HEIGHT)
    assert video.frames.shape == (3, HEIGHT, WIDTH, 3)
    assert [grey_of(frame) for frame in video.frames] == pytest.approx([100, 140, 180], abs=4)
    assert video.timestamps.tolist() == pytest.approx([2 / FPS, 3 / FPS, 4 / FPS])


def test_colours_are_red_green_blue(tmp_path: Path):
    frame = read_video(write_video(tmp_path / "a.mp4"), 0, 1, HEIGHT).frames[0]
    assert frame[16, 8].tolist() == pytest.approx([200, 30, 30], abs=12)


def test_large_frames_are_scaled_down_and_small_ones_left_alone(tmp_path: Path):
    path = write_video(tmp_path / "a.mp4")
    small = read_video(path, 0, 1, HEIGHT // 2)
    assert small.frames.shape[1:3] == (HEIGHT // 2, WIDTH // 2)
    assert small.recorded_size == (WIDTH, HEIGHT)
    assert read_video(path, 0, 1, 10 * HEIGHT).frames.shape[1:3] == (HEIGHT, WIDTH)


def test_a_rotated_recording_is_turned_upright(tmp_path: Path):
    recording = write_video(tmp_path / "a.mp4")
    plain = read_video(recording, 0, 1, 1000).frames[0].numpy()
    turned = read_video(held_otherwise(tmp_path / "b.mp4", recording, 90), 0, 1, 1000)
    assert turned.recorded_size == (HEIGHT, WIDTH)
    assert np.abs(turned.frames[0].numpy() - np.rot90(plain).astype(int)).max() <= 2


def test_a_missing_file_is_named(tmp_path: Path):
    with pytest.raises(ArtifactError, match=r"no video .*nowhere\.mp4"):
        read_video(tmp_path / "nowhere.mp4", 0, 1, 100)


def test_too_few_frames_are_counted(tmp_path: Path):
    path = write_video(tmp_path / "a.mp4")
    with pytest.raises(ArtifactError, match=r"ends after 6 frames, wanted frames 4 to 8"):
        read_video(path, 4, 9, 100)


def test_a_file_that_is_no_video_cannot_be_decoded(tmp_path: Path):
    path = tmp_path / "a.mp4"
    path.write_text("not a video")
    with pytest.raises(ArtifactError, match=r"a\.mp4 cannot be decoded"):
        read_video(path, 0, 1, 100)


def test_a_truncated_file_is_refused(tmp_path: Path):
    whole = write_video(tmp_path / "a.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ArtifactError, match=r"cut\.mp4"):
        read_video(tmp_path / "cut.mp4", 0, COUNT, 100)


def test_a_sound_file_holds_no_video(tmp_path: Path):
    path = tmp_path / "sound.wav"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        stream.layout = "mono"
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), "s16", "mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
    with pytest.raises(ArtifactError, match="holds no video"):
        read_video(path, 0, 1, 100)


def test_frames_that_change_size_are_refused(tmp_path: Path):
    path = tmp_path / "pictures.mjpeg"
    blobs = []
    for index, (width, height) in enumerate([(48, 32), (48, 32), (64, 32)]):
        single = tmp_path / f"{index}.mjpeg"
        with av.open(str(single), "w") as container:
            stream = container.add_stream("mjpeg", rate=FPS)
            stream.width, stream.height, stream.pix_fmt = width, height, "yuvj420p"
            frame = av.VideoFrame.from_ndarray(picture(index, width, height), format="rgb24")
            container.mux(stream.encode(frame))
            container.mux(stream.encode())
        blobs.append(single.read_bytes())
    path.write_bytes(b"".join(blobs))
    assert len(read_video(path, 0, 2, 100).frames) == 2
    with pytest.raises(ArtifactError, match=r"frame 2 is \(64, 32\), those before it \(48, 32\)"):
        read_video(path, 0, 3, 100)
