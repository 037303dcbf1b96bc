import math
from pathlib import Path

import pytest
from PIL import Image

from deblur_avatar.sources.focal_length import focal_of_files, focal_of_view
from tests.sources.small_videos import picture, write_video

APPLE = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
PICTURES = [picture(index) for index in range(2)]


def test_a_field_of_view_of_ninety_degrees_is_half_the_longer_side():
    assert focal_of_view(90.0, (640, 480)) == pytest.approx(320)
    assert focal_of_view(90.0, (480, 640)) == pytest.approx(320)


def test_a_phone_s_video_tells_its_equivalent_focal_length(tmp_path: Path):
    path = write_video(tmp_path / "a.mp4", PICTURES, metadata={APPLE: "26"})
    # 43.27 mm is the diagonal of film.
    assert focal_of_files(path, (1920, 1080)) == pytest.approx(
        26 / 43.2666 * math.hypot(1920, 1080)
    )


def test_a_picture_s_exif_tells_it(tmp_path: Path):
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 50  # FocalLengthIn35mmFilm
    Image.fromarray(PICTURES[0]).save(tmp_path / "a.jpg", exif=exif)
    assert focal_of_files(tmp_path, (300, 400)) == pytest.approx(50 / 43.2666 * 500)


@pytest.mark.parametrize("entry", ["0", "4000", "unknown"])
def test_an_entry_that_no_lens_has_is_not_believed(tmp_path: Path, entry: str):
    path = write_video(tmp_path / "a.mp4", PICTURES, metadata={APPLE: entry})
    assert focal_of_files(path, (1920, 1080)) is None


def test_files_that_do_not_tell_give_nothing(tmp_path: Path):
    assert focal_of_files(write_video(tmp_path / "a.mp4", PICTURES), (48, 32)) is None
    Image.fromarray(PICTURES[0]).save(tmp_path / "a.png")
    assert focal_of_files(tmp_path, (48, 32)) is None
