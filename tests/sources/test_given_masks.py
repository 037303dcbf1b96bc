import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.given_masks import read_masks

SIZE = (24, 16)


def mask(value: int = 255, size: tuple[int, int] = SIZE) -> np.ndarray:
    """The right half is person."""
    picture = np.zeros(size[::-1], np.uint8)
    picture[:, size[0] // 2 :] = value
    return picture


def parts(*values: int) -> np.ndarray:
    """The right half has several labels."""
    picture = mask(0).astype(np.uint16)
    picture[:, SIZE[0] // 2 :] = np.resize(values, SIZE[0] // 2)
    return picture if max(values) > 255 else picture.astype(np.uint8)


def written(folder: Path, *pictures: Image.Image) -> Path:
    folder.mkdir()
    for index, picture in enumerate(pictures):
        picture.save(folder / f"{index}.png")
    return folder


def palette(picture: np.ndarray) -> Image.Image:
    coloured = Image.fromarray(picture, "P")
    coloured.putpalette([200, 200, 200] * 20)  # the colours say nothing
    return coloured


@pytest.mark.parametrize(
    "picture",
    [
        Image.fromarray(mask(1)),
        Image.fromarray(mask(38)),
        Image.fromarray(mask().astype(bool)),
        Image.fromarray(mask().astype(np.uint16) * 3),
        Image.fromarray(np.dstack([mask(0), mask(7), mask(0)])),
        Image.fromarray(np.dstack([mask(9)] * 3 + [np.full_like(mask(), 255)])),
        palette(mask(15)),
        Image.fromarray(mask(255, (48, 32))),
        Image.fromarray(parts(1, 2)),
        Image.fromarray(parts(1, 255)),
        Image.fromarray(parts(2, 15, 255)),
        Image.fromarray(parts(85, 170, 255)),
        Image.fromarray(parts(10, 128, 245, 255)),
        Image.fromarray(np.dstack([parts(3, 255)] * 3)),
        Image.fromarray(parts(11, 700, 26001).astype(np.uint16)),
        palette(parts(1, 2)),
    ],
    ids=[
        "label 1",
        "label 38",
        "bits",
        "16 bits",
        "colours",
        "alpha",
        "palette",
        "twice the size",
        "two labels",
        "a label and void",
        "labels and void",
        "spread labels",
        "labels at both ends",
        "grey colours",
        "16-bit labels",
        "DAVIS",
    ],
)
def test_what_is_not_black_is_person_whatever_the_file(tmp_path: Path, picture: Image.Image):
    (found,) = read_masks(written(tmp_path / "m", picture), (0,), 1, SIZE)
    assert (found.numpy() == mask()).all()


def test_a_soft_mask_keeps_its_coverage(tmp_path: Path):
    soft = np.tile(np.linspace(0, 255, SIZE[0]).astype(np.uint8), (SIZE[1], 1))
    (found,) = read_masks(written(tmp_path / "m", Image.fromarray(soft)), (0,), 1, SIZE)
    assert (found.numpy() == soft).all()


def soft_mask() -> np.ndarray:
    """A network's: hardly ever quite black."""
    ramp = np.linspace(1, 255, SIZE[0]).astype(np.uint8)
    return np.tile(ramp, (SIZE[1], 1))


@pytest.mark.parametrize(
    "picture",
    [
        Image.fromarray(np.dstack([soft_mask()] * 3)),
        Image.fromarray(np.dstack([soft_mask()] * 3 + [np.full_like(soft_mask(), 255)])),
        Image.fromarray(soft_mask().astype(np.uint16) * 257),
    ],
    ids=["RGB", "opaque RGBA", "16 bits"],
)
def test_a_soft_mask_keeps_its_coverage_in_other_files_too(tmp_path: Path, picture: Image.Image):
    (found,) = read_masks(written(tmp_path / "m", picture), (0,), 1, SIZE)
    assert (found.numpy() == soft_mask()).all()


@pytest.mark.parametrize("quality", [50, 75, 85, 90, 95, 98, 100])
@pytest.mark.parametrize("colours", [1, 3])
def test_what_a_codec_left_off_black_is_no_person(tmp_path: Path, quality: int, colours: int):
    rows, columns = np.mgrid[:64, :96]
    hard = np.where(np.hypot((rows - 30) / 25, (columns - 49) / 17) < 1, 255, 0).astype(np.uint8)
    file = io.BytesIO()
    picture = Image.fromarray(hard if colours == 1 else np.dstack([hard] * 3))
    picture.save(file, "JPEG", quality=quality)
    (tmp_path / "m").mkdir()
    (tmp_path / "m/0.jpg").write_bytes(file.getvalue())
    (found,) = read_masks(tmp_path / "m", (0,), 1, (96, 64))
    assert ((found.numpy() > 127) == (hard > 127)).all()


def test_a_soft_mask_that_shows_nobody_is_known_by_the_others(tmp_path: Path):
    """A network leaves a code or two of 255 all over, which is no person all over."""
    greys = np.tile(np.linspace(0, 255, SIZE[0]).astype(np.uint8), (SIZE[1], 1))
    noise = np.random.default_rng(0).integers(0, 3, greys.shape).astype(np.uint8)
    for index in range(40):
        Image.fromarray(noise if index == 23 else greys).save(tmp_path / f"{index}.png")
    masks = read_masks(tmp_path, tuple(range(40)), 40, SIZE)
    assert masks[23].max() <= 2
    assert (masks[0].numpy() == greys).all()


def test_twenty_labels_are_no_soft_mask(tmp_path: Path):
    labels = np.tile(np.arange(SIZE[0], dtype=np.uint8), (SIZE[1], 1))
    (found,) = read_masks(written(tmp_path / "m", Image.fromarray(labels)), (0,), 1, SIZE)
    assert (found.numpy() == np.where(labels > 0, 255, 0)).all()


def test_masks_are_those_of_the_frames_taken(tmp_path: Path):
    pictures = [mask() if index == 2 else mask(0) for index in range(4)]
    folder = written(tmp_path / "m", *map(Image.fromarray, pictures))
    found = read_masks(folder, (0, 2), 4, SIZE)
    assert found.flatten(1).any(1).tolist() == [False, True]


def test_masks_that_do_not_fit_the_frames_are_refused(tmp_path: Path):
    folder = written(tmp_path / "m", *[Image.fromarray(mask())] * 3)
    with pytest.raises(ArtifactError, match="holds 3 masks, the footage has 4 frames"):
        read_masks(folder, (0, 1, 2), 4, SIZE)
    with pytest.raises(ArtifactError, match="24 x 16, of another shape than the frames"):
        read_masks(folder, (0,), 3, (16, 24))
    with pytest.raises(ArtifactError, match="check clip.masks"):
        read_masks(tmp_path / "no", (0,), 1, SIZE)


def test_black_and_damaged_masks_are_refused(tmp_path: Path):
    with pytest.raises(ArtifactError, match="every mask is black"):
        read_masks(written(tmp_path / "m", Image.fromarray(mask(0))), (0,), 1, SIZE)
    (tmp_path / "n").mkdir()
    (tmp_path / "n" / "0.png").write_bytes(b"no picture")
    with pytest.raises(ArtifactError, match=r"0\.png is not a picture"):
        read_masks(tmp_path / "n", (0,), 1, SIZE)
