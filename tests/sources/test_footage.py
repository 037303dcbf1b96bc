from pathlib import Path

import cv2
import numpy as np
import pytest

from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.sources.footage import (
    Footage,
    check_readable,
    files_in_order,
    read_footage,
)
from tests.process_state import ordinary_user
from tests.sources.small_videos import FPS, HEIGHT, WIDTH, held_otherwise, picture, write_video

PICTURES = [picture(index) for index in range(6)]


def read(path: Path, **changes: object) -> Footage:
    asked = {"frames": (0, None), "stride": 1, "fps": 10.0, "height": HEIGHT} | changes
    return read_footage(path, **asked)  # type: ignore[arg-type]


def write_pictures(folder: Path, pictures: list[np.ndarray], suffix: str = ".png") -> Path:
    folder.mkdir()
    for index, image in enumerate(pictures):
        cv2.imwrite(str(folder / f"f{index}{suffix}"), image)
    return folder


def test_times_come_from_the_container(tmp_path: Path):
    times = [0.0, 0.04, 0.09, 0.12, 0.2, 0.21]
    footage = read(write_video(tmp_path / "a.mp4", PICTURES, times))
    assert footage.timestamps.tolist() == pytest.approx(times)
    assert footage.numbers == (0, 1, 2, 3, 4, 5)
    assert footage.total == 6


def test_a_repeated_frame_is_left_out_and_said(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    repeated = [PICTURES[0], PICTURES[1], PICTURES[1], PICTURES[2]]
    footage = read(write_video(tmp_path / "a.mp4", repeated))
    assert footage.numbers == (0, 1, 3)
    assert footage.timestamps.tolist() == pytest.approx([0, 1 / FPS, 3 / FPS])
    assert "1 repeated frames left out: 2" in caplog.text
    assert footage.interval == pytest.approx(1 / FPS)


def test_a_repeat_in_a_clip_of_three_frames_is_no_frame_rate(tmp_path: Path):
    footage = read(write_video(tmp_path / "a.mp4", [PICTURES[0], PICTURES[0], PICTURES[1]]))
    assert footage.numbers == (0, 2)
    assert footage.interval == pytest.approx(1 / FPS)


def test_a_dropped_frame_leaves_a_gap_in_time(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    footage = read(write_video(tmp_path / "a.mp4", PICTURES[:4], [0, 0.04, 0.12, 0.16]))
    assert footage.timestamps.diff().tolist() == pytest.approx([0.04, 0.08, 0.04])
    assert "1 gaps in time, after frames 1" in caplog.text


def test_a_rotated_recording_is_upright_and_its_size_too(tmp_path: Path):
    recording = write_video(tmp_path / "a.mp4", PICTURES)
    plain = read(recording, height=100).frames[0].numpy()
    turned = read(held_otherwise(tmp_path / "b.mp4", recording, 90), height=100)
    assert turned.recorded_size == (HEIGHT, WIDTH)
    assert (turned.frames[0].numpy() == np.rot90(plain)).all()


@pytest.mark.parametrize("rotation", [0, 90, 180, -90])
@pytest.mark.parametrize("mirrored", ["hflip", "vflip"])
def test_a_recording_that_is_to_be_mirrored_is(tmp_path: Path, rotation: int, mirrored: str):
    """As front cameras and editors ask for; turned first, then mirrored."""
    corners = [np.pad(picture(index), ((8, 0), (0, 0), (0, 0))) for index in range(3)]
    recording = write_video(tmp_path / "a.mp4", corners)
    plain = read(recording, height=100).frames[0].numpy()
    other = held_otherwise(tmp_path / "b.mp4", recording, rotation, **{mirrored: True})
    expected = np.flip(np.rot90(plain, rotation // 90 % 4), 1 if mirrored == "hflip" else 0)
    assert (read(other, height=100).frames[0].numpy() == expected).all()


def test_files_of_a_camera_that_were_joined_are_two_recordings(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    """Whose clock starts anew; the frames of the second were left out as repeated, untold."""
    scene = np.random.default_rng(0).integers(0, 255, (HEIGHT, 4 * WIDTH, 3), np.uint8)
    pictures = [scene[:, 2 * index : 2 * index + WIDTH] for index in range(24)]
    parts = [
        write_video(tmp_path / f"{name}.ts", part, [index / FPS for index in range(len(part))])
        for name, part in (("a", pictures[:9]), ("b", pictures[9:]))
    ]
    joined = tmp_path / "joined.ts"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    footage = read(joined)
    assert footage.numbers == tuple(range(9, 24))
    assert footage.timestamps.diff().tolist() == pytest.approx([1 / FPS] * 14, abs=1e-3)
    assert "2 shots, cut before frames 9" in caplog.text


def test_every_second_frame_of_a_part_keeps_its_number_and_time(tmp_path: Path):
    footage = read(write_video(tmp_path / "a.mp4", PICTURES), frames=(1, 6), stride=2)
    assert footage.numbers == (1, 3, 5)
    assert footage.timestamps.tolist() == pytest.approx([1 / FPS, 3 / FPS, 5 / FPS])
    assert footage.interval == pytest.approx(1 / FPS)


def test_a_folder_is_read_in_natural_order_at_its_frame_rate(tmp_path: Path):
    pictures = [picture(index) for index in range(11)]
    footage = read(write_pictures(tmp_path / "frames", pictures))
    assert footage.frames[:, 0, -1, 0].tolist() == [20 * index + 20 for index in range(11)]
    assert footage.timestamps.tolist() == pytest.approx([index / 10 for index in range(11)])
    assert [path.stem for path in files_in_order(tmp_path / "frames", (".png",))][2] == "f2"


def test_pictures_of_any_depth_and_channels_become_colours(tmp_path: Path):
    deep = PICTURES[0].astype(np.uint16) * 257
    clear = np.dstack([PICTURES[1], np.full((HEIGHT, WIDTH), 255, np.uint8)])
    grey = PICTURES[2][..., 1]
    footage = read(write_pictures(tmp_path / "frames", [deep, clear, grey]))
    assert footage.frames.shape == (3, HEIGHT, WIDTH, 3)
    assert footage.frames[0, 0, 0].tolist() == [30, 30, 200]  # written as blue, green, red
    assert footage.frames[1, 0, 0].tolist() == [30, 30, 200]
    assert footage.frames[2, 0, 0].tolist() == [30, 30, 30]


def test_what_is_not_there_is_named(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"no video and no folder .*nowhere\.mp4"):
        read(tmp_path / "nowhere.mp4")


@pytest.mark.parametrize("name", ["frames", "frames/a.mp4", "frames/f0.png", "a.mp4"])
def test_what_may_not_be_read_is_said_so(tmp_path: Path, name: str):
    closed = [write_pictures(tmp_path / "frames", PICTURES)]
    closed.append(write_video(tmp_path / "a.mp4", PICTURES))
    for path in closed:
        path.chmod(0)
    with ordinary_user(), pytest.raises(ArtifactError, match=rf"{name} may not be read by you; al"):
        check_readable(tmp_path / name)
    for path in closed:
        path.chmod(0o700)


def test_a_name_that_no_disk_takes_is_no_footage(tmp_path: Path):
    with pytest.raises(ArtifactError, match="a.mp4 cannot be read: File name too long"):
        check_readable(tmp_path / f"{300 * 'a'}.mp4")


@pytest.mark.parametrize("content", [b"", b"not a video at all"])
def test_a_file_that_is_no_video_is_refused(tmp_path: Path, content: bytes):
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    with pytest.raises(ArtifactError, match=r"a\.mp4 cannot be decoded"):
        read(path)


def test_an_empty_folder_is_refused(tmp_path: Path):
    with pytest.raises(ArtifactError, match="holds 0 pictures, at least two are needed; pictures"):
        read(write_pictures(tmp_path / "frames", []))


def test_one_picture_or_frame_is_too_few(tmp_path: Path):
    folder = write_pictures(tmp_path / "frames", PICTURES[:1])
    with pytest.raises(ArtifactError, match="frames holds 1 picture, at least two are needed; pic"):
        check_readable(folder)
    with pytest.raises(ArtifactError, match="frames shows 1 picture; a clip is two or more"):
        read(folder)
    video = write_video(tmp_path / "a.mp4", PICTURES[:1])
    with pytest.raises(ArtifactError, match=r"a\.mp4 holds 1 frame, at least two are needed; film"):
        check_readable(video)
    with pytest.raises(ArtifactError, match=r"a\.mp4 shows 1 picture; a clip is two or more"):
        read(video)


def test_pictures_of_two_sizes_are_refused(tmp_path: Path):
    folder = write_pictures(tmp_path / "frames", [PICTURES[0], picture(1, WIDTH + 2)])
    with pytest.raises(ArtifactError, match=r"f1\.png is \(50, 32\)"):
        read(folder)


def test_a_clip_of_one_picture_is_refused(tmp_path: Path):
    folder = write_pictures(tmp_path / "frames", [PICTURES[0]] * 3)
    with pytest.raises(ArtifactError, match="shows 1 picture"):
        read(folder)


def test_a_range_without_two_frames_is_refused(tmp_path: Path):
    path = write_video(tmp_path / "a.mp4", PICTURES)
    with pytest.raises(ConfigError, match="fewer than two frames"):
        read(path, frames=(2, 3))
    with pytest.raises(ArtifactError, match="ends after 6 frames"):
        read(path, frames=(2, 9))
