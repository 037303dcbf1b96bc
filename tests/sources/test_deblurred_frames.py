import numpy as np
import pytest
import torch

from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.picture_files import write_picture
from deblur_avatar.sources.deblurred_frames import read_deblurred
from tests.sources.small_videos import write_video

BLURRED = torch.zeros(12, 16, 24, 3, dtype=torch.uint8)


def levels(count: int, height: int = 16, width: int = 24) -> np.ndarray:
    """Frames each of which is brighter than the one before."""
    return np.stack([np.full((height, width, 3), 20 * i, np.uint8) for i in range(count)])


def test_pictures_come_in_the_natural_order_of_their_names(tmp_path):
    for index, picture in enumerate(levels(12)):
        write_picture(tmp_path / f"out_{index}.png", picture)  # out_10 after out_9, not after out_1
    (tmp_path / "notes.txt").write_text("not a picture")
    read = read_deblurred(tmp_path, BLURRED, "here")
    assert torch.equal(read, torch.from_numpy(levels(12)))


def test_a_video_is_read_frame_by_frame(tmp_path):
    write_video(tmp_path / "out.mp4", list(levels(12)))
    read = read_deblurred(tmp_path / "out.mp4", BLURRED, "here")
    assert torch.equal(read, torch.from_numpy(levels(12)))


@pytest.mark.parametrize("count", [0, 11, 13])
def test_another_number_of_pictures_is_refused(tmp_path, count):
    for index in range(count):
        write_picture(tmp_path / f"{index}.png", levels(1)[0])
    with pytest.raises(ArtifactError, match=f"here: .* holds {count} pictures, wanted 12: one for"):
        read_deblurred(tmp_path, BLURRED, "here")


def test_another_number_of_a_video_s_frames_is_refused(tmp_path):
    write_video(tmp_path / "out.mp4", list(levels(11)))
    with pytest.raises(ArtifactError, match="holds 11 frames, wanted 12"):
        read_deblurred(tmp_path / "out.mp4", BLURRED, "here")


@pytest.mark.parametrize("size", [(8, 12), (32, 48), (16, 32)])
def test_frames_of_another_size_are_refused_and_never_scaled(tmp_path, size):
    write_video(tmp_path / "out.mp4", list(levels(12, *size)))
    complaint = f"frame 0 of .* is {size[1]} x {size[0]} pixels, the blurred frames are 24 x 16"
    with pytest.raises(ArtifactError, match=complaint):
        read_deblurred(tmp_path / "out.mp4", BLURRED, "here")
    (tmp_path / "folder").mkdir()
    for index, picture in enumerate(levels(12)):
        wrong = levels(1, *size)[0] if index == 7 else picture
        write_picture(tmp_path / "folder" / f"{index}.png", wrong)
    with pytest.raises(ArtifactError, match="frame 7 of"):
        read_deblurred(tmp_path / "folder", BLURRED, "here")


def test_a_path_that_leads_nowhere_is_refused(tmp_path):
    with pytest.raises(ArtifactError, match="here: no folder and no video .*nowhere"):
        read_deblurred(tmp_path / "nowhere", BLURRED, "here")


def test_a_file_that_is_no_video_is_refused(tmp_path):
    (tmp_path / "out.mp4").write_bytes(b"no video at all")
    with pytest.raises(ArtifactError, match="cannot be decoded"):
        read_deblurred(tmp_path / "out.mp4", BLURRED, "here")
