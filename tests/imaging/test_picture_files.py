import numpy as np
import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.picture_files import encoded, read_picture, write_picture


@pytest.fixture
def picture():
    return np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)


def test_a_png_file_holds_exactly_the_picture(tmp_path, picture):
    write_picture(tmp_path / "deep" / "a.png", picture)
    np.testing.assert_array_equal(read_picture(tmp_path / "deep" / "a.png"), picture)


def test_red_is_red_to_other_readers(tmp_path):
    from PIL import Image

    red = np.zeros((2, 3, 3), np.uint8)
    red[..., 0] = 255
    write_picture(tmp_path / "red.png", red)
    assert Image.open(tmp_path / "red.png").getpixel((1, 1)) == (255, 0, 0)


def test_equal_pictures_are_equal_bytes(tmp_path, picture):
    write_picture(tmp_path / "a.png", picture)
    write_picture(tmp_path / "b.png", picture)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png"]


def test_jpeg_stays_near_a_smooth_picture(tmp_path):
    ramp = np.broadcast_to(np.linspace(0, 255, 32, dtype=np.uint8)[:, None], (32, 32))
    smooth = np.stack([ramp, ramp[::-1], ramp.T], -1)
    (tmp_path / "a.jpg").write_bytes(encoded(smooth, ".jpg"))
    difference = np.abs(read_picture(tmp_path / "a.jpg").astype(int) - smooth)
    assert difference.mean() < 5


def test_missing_and_foreign_files_are_refused(tmp_path):
    with pytest.raises(ArtifactError, match="cannot read .*a.png: No such file"):
        read_picture(tmp_path / "a.png")
    (tmp_path / "a.png").write_bytes(b"")
    with pytest.raises(ArtifactError, match="a.png is not a picture"):
        read_picture(tmp_path / "a.png")
    (tmp_path / "a.png").write_text("text")
    with pytest.raises(ArtifactError, match="a.png is not a picture"):
        read_picture(tmp_path / "a.png")


def test_a_folder_that_cannot_be_made_is_named(tmp_path, picture):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArtifactError, match="cannot write .*file/a.png"):
        write_picture(tmp_path / "file" / "a.png", picture)
