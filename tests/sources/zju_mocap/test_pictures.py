import logging

import cv2
import numpy as np
import pytest
from PIL import Image

from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.zju_mocap.pictures import (
    mask_folders_here,
    picture_size,
    read_person,
)

NAME = "Camera_B1/000000.png"


@pytest.fixture
def picture():
    return np.random.default_rng(0).integers(1, 256, (8, 10, 3), dtype=np.uint8)


@pytest.fixture
def folder(tmp_path, picture):
    """One picture; `mask` has its left part, `mask_cihp` a spot on the right."""
    left, right = np.zeros((8, 10), np.uint8), np.zeros((8, 10), np.uint8)
    left[:, :3], right[4, 8] = 1, 19
    for name, content in (("", picture), ("mask", left), ("mask_cihp", right)):
        path = tmp_path / "root" / name / NAME
        path.parent.mkdir(parents=True)
        Image.fromarray(content).save(path)
    return tmp_path / "root"


def test_masks_of_several_folders_are_joined(folder, picture):
    read, matte = read_person(folder, NAME, ["mask", "mask_cihp"], 0, on_black=True)
    wanted = np.zeros((8, 10), bool)
    wanted[:, :3] = wanted[4, 8] = True
    np.testing.assert_array_equal(matte.numpy(), wanted * np.uint8(255))
    np.testing.assert_array_equal(read.numpy(), picture * wanted[..., None])
    _, matte = read_person(folder, NAME, ["mask"], 0, on_black=True)
    np.testing.assert_array_equal(matte[:, 3:], 0)


def test_a_picture_as_filmed_keeps_its_background(folder, picture):
    read, _ = read_person(folder, NAME, ["mask"], 0, on_black=False)
    np.testing.assert_array_equal(read.numpy(), picture)


def test_masks_grow_by_the_pixels_asked_for(folder):
    _, matte = read_person(folder, NAME, ["mask_cihp"], 1, on_black=True)
    grown = {(4, 8), (3, 8), (5, 8), (4, 7), (4, 9)}
    assert {tuple(place) for place in np.argwhere(matte.numpy()).tolist()} == grown


def test_a_mask_of_another_size_is_refused(folder):
    Image.new("L", (5, 4), 255).save(folder / "mask" / NAME)
    with pytest.raises(ArtifactError, match=r"mask/.* has 5 x 4 pixels, its picture 10 x 8"):
        read_person(folder, NAME, ["mask"], 0, on_black=True)


def test_a_missing_picture_or_mask_is_named(folder):
    (folder / "mask_cihp" / NAME).unlink()
    with pytest.raises(ArtifactError, match=r"cannot read .*mask_cihp/Camera_B1/000000.png: No"):
        read_person(folder, NAME, ["mask", "mask_cihp"], 0, on_black=True)
    (folder / NAME).unlink()
    with pytest.raises(ArtifactError, match=r"cannot read .*root/Camera_B1/000000.png: No such"):
        read_person(folder, NAME, ["mask"], 0, on_black=True)


def test_masks_of_one_folder_do_where_the_other_is_not_there(folder, caplog):
    wanted = ["mask", "mask_cihp"]
    assert mask_folders_here(folder, wanted) == wanted
    (folder / "mask_cihp").rename(folder / "elsewhere")
    with caplog.at_level(logging.WARNING):
        assert mask_folders_here(folder, wanted) == ["mask"]
    assert "no folder mask_cihp" in caplog.text
    with pytest.raises(ArtifactError, match="has no folder of masks; wanted mask_cihp"):
        mask_folders_here(folder, ["mask_cihp"])


def test_nothing_outside_the_folder_is_read(folder, picture):
    outside = folder.parent / "secret.png"
    Image.fromarray(picture).save(outside)
    with pytest.raises(ArtifactError, match=r"'\.\./secret\.png' leads out of .*root; nothing out"):
        picture_size(folder, "../secret.png")
    with pytest.raises(ArtifactError, match="leads out of"):
        picture_size(folder, str(outside))
    (folder / "link.png").symlink_to(outside)
    with pytest.raises(ArtifactError, match=r"'link.png' leads out of"):
        picture_size(folder, "link.png")
    (folder / "mask" / NAME).unlink()
    (folder / "mask" / NAME).symlink_to(outside)
    with pytest.raises(ArtifactError, match=r"'mask/Camera_B1/000000.png' leads out of"):
        read_person(folder, NAME, ["mask"], 0, on_black=True)
    (folder / "inside.png").symlink_to(folder / NAME)
    assert picture_size(folder, "inside.png") == (10, 8)


def test_pictures_of_every_kind_show_the_same_person(folder, picture):
    def person(content, suffix):
        path = (folder / NAME).with_suffix(suffix)
        path.write_bytes(content) if isinstance(content, bytes) else content.save(path)
        name = str(path.relative_to(folder))
        return read_person(folder, name, ["mask"], 0, on_black=True)[0].numpy()

    wanted = person(Image.fromarray(picture), ".png")
    deep = cv2.imencode(".png", picture[..., ::-1].astype(np.uint16) * 257)[1].tobytes()
    np.testing.assert_array_equal(person(deep, ".png"), wanted)
    opaque = np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])
    np.testing.assert_array_equal(person(Image.fromarray(opaque), ".png"), wanted)
    ink = person(Image.fromarray(picture).convert("CMYK"), ".tiff")
    np.testing.assert_allclose(ink.astype(int), wanted, atol=2)
    grey = person(Image.fromarray(picture[..., 0]), ".png")
    np.testing.assert_array_equal(grey, wanted[..., :1].repeat(3, axis=2))
