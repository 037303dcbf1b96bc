import io
from pathlib import Path

import cv2
import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image, ImageOps

from deblur_avatar.errors import ArtifactError
from deblur_avatar.readers.picture_codec import (
    HALF_EXR,
    JPEG,
    QUICK_PNG,
    STORED_PNG,
    encoded,
    read_attribute,
    read_pixels,
)

ORIENTATION = 0x0112


def noise(height: int = 40, width: int = 56) -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)


def smooth() -> np.ndarray:
    return cv2.GaussianBlur(noise(), (0, 0), 3)


PICTURES = {
    "noise": noise(),
    "smooth": smooth(),
    "flat": np.full((30, 50, 3), 200, np.uint8),
    "one pixel": noise(1, 1),
    "large": cv2.resize(noise(), (700, 500)),
    "grey": smooth()[..., :1].copy(),
}


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize(
    ("suffix", "options", "flags"),
    [
        (".png", STORED_PNG, [cv2.IMWRITE_PNG_COMPRESSION, 3]),
        (".png", QUICK_PNG, []),
        (".jpg", JPEG, [cv2.IMWRITE_JPEG_QUALITY, 90]),
    ],
    ids=["stored", "quick", "jpeg"],
)
def test_files_have_the_bytes_that_stored_hashes_were_taken_of(name, suffix, options, flags):
    # Those were written by OpenCV, which contains the same zlib, libpng and libjpeg-turbo.
    picture = PICTURES[name]
    wanted = cv2.imencode(suffix, picture[..., ::-1].copy(), flags)[1].tobytes()
    assert encoded(picture, suffix, options) == wanted


@pytest.mark.parametrize("called", ["caf\udce9/a.png", "caf\udce9.png"])
def test_a_name_that_is_not_utf_8_is_said_to_be_none(tmp_path: Path, called: str):
    path = tmp_path / called
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(encoded(noise(), ".png", QUICK_PNG))
    for read in (read_pixels, lambda path: read_attribute(path, "Orientation")):
        with pytest.raises(
            ArtifactError, match=r"^the name b'.*/caf\\xe9.*' is not UTF-8; rename it$"
        ):
            read(path)


def test_an_exr_file_holds_half_precision_and_no_date(tmp_path: Path):
    light = np.random.default_rng(0).random((5, 7, 3), dtype=np.float32) * 4
    (tmp_path / "a.exr").write_bytes(encoded(light, ".exr", HALF_EXR))
    found = read_pixels(tmp_path / "a.exr")
    assert found.linear
    np.testing.assert_array_equal(found.values, light.astype(np.float16))
    assert read_attribute(tmp_path / "a.exr", "DateTime") is None
    assert encoded(light, ".exr", HALF_EXR) == (tmp_path / "a.exr").read_bytes()


def test_an_exr_file_may_hold_whole_floats(tmp_path: Path):
    light = np.random.default_rng(0).random((5, 7, 3), dtype=np.float32)
    assert oiio.ImageBuf(light).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.exr").values, light)


def _kinds() -> dict[str, Image.Image | tuple[Image.Image, dict[str, object]]]:
    rgb, grey = Image.fromarray(noise()), Image.fromarray(noise()[..., 0])
    soft = Image.fromarray(smooth())
    palette = Image.fromarray(noise()[..., 0] // 16, mode="P")
    palette.putpalette(list(range(48)))
    return {
        "rgb.png": rgb, "grey.png": grey, "bits.png": Image.fromarray(noise()[..., 0] > 99),
        "alpha.png": Image.fromarray(np.dstack([noise(), noise()[..., 0]])),
        "grey_alpha.png": Image.fromarray(noise()[..., :2].copy(), mode="LA"),
        "deep.png": Image.fromarray(noise()[..., 0].astype(np.uint16) * 256 + 99),
        "palette.png": palette, "sharp.jpg": (rgb, {"quality": 95, "subsampling": 0}),
        "soft.jpg": soft, "grey.jpg": grey, "progressive.jpg": (soft, {"progressive": True}),
        "ink.jpg": soft.convert("CMYK"), "ink.tif": soft.convert("CMYK"), "rgb.tif": rgb,
        "lzw.tif": (rgb, {"compression": "tiff_lzw"}), "rgb.bmp": rgb, "rgb.ppm": rgb,
        "deep.tif": Image.fromarray(noise()[..., 0].astype(np.uint16) * 256 + 99),
        "lossless.webp": (rgb, {"lossless": True}), "lossy.webp": soft,
    }  # fmt: skip


@pytest.mark.parametrize("name", _kinds())
def test_every_kind_of_file_gives_what_pillow_reads(tmp_path: Path, name: str):
    made = _kinds()[name]
    image, options = made if isinstance(made, tuple) else (made, {})
    image.save(tmp_path / name, **options)
    with Image.open(tmp_path / name) as opened:
        other = opened.convert("RGB") if opened.mode in ("P", "CMYK") else opened
        wanted = np.asarray(other)
    wanted = wanted * np.uint8(255) if wanted.dtype == bool else wanted
    found = read_pixels(tmp_path / name)
    np.testing.assert_array_equal(found.values.reshape(wanted.shape), wanted)
    assert found.alpha == ("alpha" in name)
    assert found.palette == ("palette" in name)
    assert not found.linear


def test_sixteen_bits_of_colour_are_read_whole(tmp_path: Path):
    deep = noise().astype(np.uint16) * 256 + 99
    cv2.imwrite(str(tmp_path / "a.png"), deep[..., ::-1])
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.png").values, deep)


@pytest.mark.parametrize("ending", ["png", "jpg", "tif", "webp"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_are_turned_as_their_metadata_say(tmp_path: Path, ending: str, orientation: int):
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    path = tmp_path / f"a.{ending}"
    Image.fromarray(smooth()).save(path, exif=exif)
    with Image.open(path) as opened:
        wanted = np.asarray(ImageOps.exif_transpose(opened))
    np.testing.assert_array_equal(read_pixels(path).values, wanted)


def test_a_file_is_what_it_holds_whatever_its_name(tmp_path: Path):
    content = encoded(smooth(), ".jpg", JPEG)
    (tmp_path / "a.jpg").write_bytes(content)
    wanted = read_pixels(tmp_path / "a.jpg").values
    for name in ("a.png", "a", "a?b=1.jpg", "a#%04d.jpg", "a.JPEG", "ä.jpg"):
        (tmp_path / name).write_bytes(content)
        np.testing.assert_array_equal(read_pixels(tmp_path / name).values, wanted, err_msg=name)


def test_kinds_that_nobody_wants_do_not_reach_their_readers(tmp_path: Path):
    stream = io.BytesIO()
    Image.fromarray(noise()).save(stream, "TGA")
    for name in ("a.tga", "a.png"):
        (tmp_path / name).write_bytes(stream.getvalue())
        with pytest.raises(ArtifactError, match="cannot be read: of no known kind|: of no known"):
            read_pixels(tmp_path / name)


def test_a_picture_of_another_size_is_refused_before_it_is_decoded(tmp_path: Path):
    (tmp_path / "a.png").write_bytes(encoded(noise(), ".png", QUICK_PNG)[:60])  # cut off
    with pytest.raises(ArtifactError, match="is 56 x 40, wanted 40 x 56"):
        read_pixels(tmp_path / "a.png", (40, 56))


def test_channels_that_are_no_colours_are_refused(tmp_path: Path):
    assert oiio.ImageBuf(np.zeros((4, 4, 6), np.float32)).write(str(tmp_path / "a.exr"))
    with pytest.raises(ArtifactError, match=r"has channels \(.*\), wanted grey or RGB"):
        read_pixels(tmp_path / "a.exr")


def test_what_cannot_be_encoded_is_said():
    with pytest.raises(OSError, match=r"cannot encode a .png picture of shape \(4, 4, 9\)"):
        encoded(np.zeros((4, 4, 9), np.uint8), ".png", QUICK_PNG)


def test_what_a_damaged_file_says_need_not_be_text(tmp_path: Path):
    assert oiio.ImageBuf(np.zeros((4, 4, 3), np.float32)).write(str(tmp_path / "a.exr"))
    content = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(content.replace(b"chlist", b"chl\xe9st"))
    with pytest.raises(ArtifactError, match="a.exr is not a picture that can be read"):
        read_pixels(tmp_path / "a.exr")


@pytest.mark.parametrize("orientation", [0, 9, 65_535])
def test_an_orientation_that_there_is_not_turns_nothing(tmp_path: Path, orientation: int):
    exif = Image.Exif()
    exif[ORIENTATION] = orientation
    Image.fromarray(noise()).save(tmp_path / "a.png", exif=exif)
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.png").values, noise())
