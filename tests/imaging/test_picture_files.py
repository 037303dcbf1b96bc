import zlib

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.color import linear_to_srgb
from deblur_avatar.imaging.picture_files import (
    jpeg_bytes,
    read_labels,
    read_mask,
    read_picture,
    write_light,
    write_picture,
)


@pytest.fixture
def picture():
    return np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)


def test_a_png_file_holds_exactly_the_picture(tmp_path, picture):
    write_picture(tmp_path / "deep" / "a.png", picture)
    np.testing.assert_array_equal(read_picture(tmp_path / "deep" / "a.png"), picture)


def test_red_is_red_to_other_readers(tmp_path):
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
    (tmp_path / "a.jpg").write_bytes(jpeg_bytes(smooth))
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


def test_sixteen_bits_become_the_upper_eight(tmp_path, picture):
    deep = picture.astype(np.uint16) * 257
    (tmp_path / "colour.png").write_bytes(cv2.imencode(".png", deep[..., ::-1])[1].tobytes())
    (tmp_path / "grey.png").write_bytes(cv2.imencode(".png", deep[..., 0])[1].tobytes())
    np.testing.assert_array_equal(read_picture(tmp_path / "colour.png"), picture)
    grey = np.repeat(picture[..., :1], 3, axis=2)
    np.testing.assert_array_equal(read_picture(tmp_path / "grey.png"), grey)


def test_sixteen_bits_may_come_with_the_upper_byte_first(tmp_path, picture):
    grey = picture[..., 0].astype(np.uint16) * 257
    made = Image.frombytes("I;16B", (7, 5), grey.astype(">u2").tobytes())
    made.save(tmp_path / "grey.tiff")
    read = read_picture(tmp_path / "grey.tiff")
    np.testing.assert_array_equal(read, np.repeat(picture[..., :1], 3, axis=2))


def test_grey_becomes_three_equal_channels(tmp_path, picture):
    Image.fromarray(picture[..., 1]).save(tmp_path / "grey.png")
    read = read_picture(tmp_path / "grey.png")
    np.testing.assert_array_equal(read, np.repeat(picture[..., 1:2], 3, axis=2))


def test_what_is_transparent_shows_black(tmp_path, picture):
    alpha = np.full(picture.shape[:2], 255, np.uint8)
    alpha[0], alpha[1] = 0, 128
    Image.fromarray(np.dstack([picture, alpha])).save(tmp_path / "alpha.png")
    read = read_picture(tmp_path / "alpha.png")
    assert not read[0].any()
    np.testing.assert_allclose(read[1], picture[1] * (128 / 255), atol=0.51)
    np.testing.assert_array_equal(read[2:], picture[2:])


@pytest.mark.parametrize("name", ["a.tiff", "a.jpg"])
def test_cmyk_inks_become_colours(tmp_path, name):
    orange = Image.new("RGB", (16, 16), (255, 128, 0))
    orange.convert("CMYK").save(tmp_path / name)
    np.testing.assert_allclose(read_picture(tmp_path / name)[8, 8], (255, 128, 0), atol=3)


def test_a_picture_is_turned_as_its_camera_was_held(tmp_path):
    wide = np.zeros((8, 24, 3), np.uint8)
    wide[:, :8, 0] = 255
    exif = Image.Exif()
    exif[0x0112] = 6  # EXIF: the first row is the right side
    Image.fromarray(wide).save(tmp_path / "a.png", exif=exif)
    read = read_picture(tmp_path / "a.png")
    assert read.shape == (24, 8, 3)
    assert (read[:8, :, 0] == 255).all()
    assert not read[8:].any()


def test_a_mask_is_true_where_its_value_is_not_zero(tmp_path):
    values = np.array([[0, 1, 100], [255, 0, 19]], np.uint8)
    person = values != 0
    pictures = {
        "labels": Image.fromarray(values),
        "sixteen": Image.fromarray(values.astype(np.uint16)),
        "yes_or_no": Image.fromarray(person),
        "colours": Image.fromarray(np.dstack([0 * values, values, 0 * values])),
        "alpha": Image.fromarray(np.dstack([values, values, values, 0 * values + 255])),
        "grey_alpha": Image.fromarray(np.dstack([values, 0 * values + 255]), mode="LA"),
    }
    for name, made in pictures.items():
        made.save(tmp_path / f"{name}.png")
        np.testing.assert_array_equal(read_mask(tmp_path / f"{name}.png"), person, err_msg=name)


def test_the_colours_of_a_mask_s_palette_do_not_matter(tmp_path):
    labels = np.array([[0, 1, 2], [2, 0, 1]], np.uint8)
    made = Image.fromarray(labels, mode="P")
    made.putpalette([255, 255, 255, 0, 0, 0, 200, 0, 0])  # label 0 is white, label 1 black
    made.save(tmp_path / "mask.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "mask.png"), labels != 0)


def test_what_is_transparent_is_no_mask(tmp_path):
    pixels = np.full((1, 2, 4), 255, np.uint8)
    pixels[0, 1, 3] = 0
    Image.fromarray(pixels).save(tmp_path / "mask.png")
    assert read_mask(tmp_path / "mask.png").tolist() == [[True, False]]


def test_a_small_file_of_a_huge_picture_is_refused(tmp_path):
    Image.new("1", (12_000, 12_000)).save(tmp_path / "bomb.png")
    assert (tmp_path / "bomb.png").stat().st_size < 50_000
    for read in (read_picture, read_mask):
        with pytest.raises(ArtifactError, match="unfolds to 12000 x 12000 pixels, at most 100 mi"):
            read(tmp_path / "bomb.png")


@pytest.mark.parametrize("ending", ["png", "jpg", "tif", "bmp", "webp", "ppm"])
def test_a_picture_that_was_cut_off_is_refused(tmp_path, ending):
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    path = tmp_path / f"a.{ending}"
    Image.fromarray(noise).save(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(ArtifactError, match=r"not a picture that can be read: .*; copy or make"):
        read_picture(path)


def test_values_of_unknown_meaning_are_refused(tmp_path):
    Image.fromarray(np.ones((2, 2), np.float32)).save(tmp_path / "a.tiff")
    with pytest.raises(ArtifactError, match="values are float32 numbers, wanted 8 or 16 bits"):
        read_picture(tmp_path / "a.tiff")
    with pytest.raises(ArtifactError, match="values are float32 numbers, wanted integers"):
        read_mask(tmp_path / "a.tiff")
    Image.new("LAB", (2, 2)).save(tmp_path / "a.tiff")
    with pytest.raises(ArtifactError, match="colours are in CIELAB, wanted grey, RGB or CMYK"):
        read_picture(tmp_path / "a.tiff")


def test_light_is_read_as_the_srgb_that_it_looks_like(tmp_path):
    light = np.random.default_rng(0).random((5, 7, 3), dtype=np.float32) * 1.2
    write_light(tmp_path / "a.exr", light)
    stored = torch.from_numpy(light.astype(np.float16).astype(np.float32).clip(0, 1))
    wanted = (linear_to_srgb(stored) * 255).round().numpy().astype(np.uint8)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr"), wanted)
    write_light(tmp_path / "a.exr", np.full((2, 2, 3), np.nan, np.float32))
    with pytest.raises(ArtifactError, match="values that are not finite"):
        read_picture(tmp_path / "a.exr")


def test_a_png_file_may_say_that_it_holds_light(tmp_path, picture):
    path = tmp_path / "a.png"
    write_picture(path, picture)
    content, gamma = path.read_bytes(), b"gAMA" + (100_000).to_bytes(4, "big")  # an exponent of 1
    chunk = b"\0\0\0\4" + gamma + zlib.crc32(gamma).to_bytes(4, "big")
    path.write_bytes(content[:33] + chunk + content[33:])
    wanted = (linear_to_srgb(torch.from_numpy(picture / 255)) * 255).round()
    np.testing.assert_array_equal(read_picture(path), wanted.numpy().astype(np.uint8))


def test_only_opaque_greys_may_be_coverage(tmp_path, picture):
    grey, opaque = picture[..., 0], np.full(picture.shape[:2], 255, np.uint8)
    clear = opaque.copy()
    clear[0, 0] = 254
    pictures = {
        "grey": Image.fromarray(grey),
        "grey rgb": Image.fromarray(np.dstack([grey] * 3)),
        "grey rgba": Image.fromarray(np.dstack([grey, grey, grey, opaque])),
        "grey la": Image.fromarray(np.dstack([grey, opaque]), mode="LA"),
        "clear": Image.fromarray(np.dstack([grey, grey, grey, clear])),
        "sixteen": Image.fromarray(grey.astype(np.uint16)),
        "colours": Image.fromarray(picture),
        "palette": Image.fromarray(grey, mode="P"),
    }
    pictures["palette"].putpalette([7, 7, 7] * 256)
    for name, made in pictures.items():
        made.save(tmp_path / f"{name}.png")
        labels, coverage = read_labels(tmp_path / f"{name}.png")
        wanted = picture.max(-1) if name == "colours" else grey
        np.testing.assert_array_equal(labels, wanted, err_msg=name)
        assert coverage == name.startswith("grey"), name


def test_sixteen_bits_that_are_made_use_of_become_eight_and_nothing_black(tmp_path):
    deep = np.array([[0, 1, 257, 258], [32767, 32768, 65278, 65535]], np.uint16)
    Image.fromarray(deep).save(tmp_path / "deep.png")
    values, coverage = read_labels(tmp_path / "deep.png")
    assert values.tolist() == [[0, 1, 1, 2], [128, 128, 254, 255]]
    assert coverage
    few = np.array([[0, 1, 255]], np.uint16)
    Image.fromarray(few).save(tmp_path / "few.png")
    values, coverage = read_labels(tmp_path / "few.png")
    assert values.tolist() == few.tolist()
    assert not coverage
