import json

import numpy as np
import pytest

from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.picture_files import read_picture
from deblur_avatar.reporting.kept_strips import keep_strips, read_strips
from deblur_avatar.reporting.picture_strips import INPUT, TRUTH, Strip

FITS = {"agnostic": 17.25, "clip": None}


def strips(*labels, level=100):
    """Two views with a plain picture a label, each as bright as its place says."""
    return [
        Strip(f"view {n}", novel_pose=False, pictures={
            label: np.full((16, 16, 3), level + 10 * i + n, np.uint8)
            for i, label in enumerate(labels)
        })
        for n in range(2)
    ]  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    keep_strips(tmp_path, strips(INPUT, *FITS, TRUTH), FITS)
    return tmp_path


def test_what_was_kept_is_read_again(folder):
    kept = read_strips(folder)
    assert (kept.captions, kept.fits, kept.truth) == (("view 0", "view 1"), FITS, True)
    levels = [read_picture(kept.picture(1, label)).mean() for label in (INPUT, *FITS, TRUTH)]
    assert levels == pytest.approx([101, 111, 121, 131], abs=2)


def test_new_strips_leave_nothing_of_those_before(folder):
    keep_strips(folder, strips(INPUT, "agnostic", level=30)[:1], {"agnostic": 18.0})
    kept = read_strips(folder)
    assert (kept.captions, kept.fits, kept.truth) == (("view 0",), {"agnostic": 18.0}, False)
    assert len(list(folder.iterdir())) == 3
    assert read_picture(kept.picture(0, INPUT)).mean() == pytest.approx(30, abs=2)


def test_pictures_whose_list_is_gone_are_no_strips(folder):
    (folder / "strips.json").unlink()
    assert read_strips(folder) is None
    assert read_strips(folder / "nowhere") is None


def test_a_missing_picture_is_named(folder):
    read_strips(folder).picture(1, "clip").unlink()
    with pytest.raises(ArtifactError, match=r"strips\.json names 1-clip\.jpg, which is missing"):
        read_strips(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"fits": 3}, "damaged: fits"), ({"captions": None}, "damaged: captions"),
     ({"fits": {"../x": 1.0}}, "damaged: fits")],
)  # fmt: skip
def test_a_damaged_list_says_where(folder, change, message):
    index = json.loads((folder / "strips.json").read_text())
    (folder / "strips.json").write_text(json.dumps(index | change))
    with pytest.raises(ArtifactError, match=message):
        read_strips(folder)
