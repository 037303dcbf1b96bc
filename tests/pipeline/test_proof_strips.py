"""Strips of the proof: what was kept stays until as much takes its place."""

import shutil

import pytest

from deblur_avatar.config.proof import Cell
from deblur_avatar.evaluation.proof_grid import read_cells
from deblur_avatar.imaging.picture_files import read_picture
from deblur_avatar.pipeline.proof_strips import current_strips, gather_strips
from deblur_avatar.reporting.kept_strips import read_strips
from tests.proof_results import small_plan, write_cell, write_pictures

MOTIONS = ("agnostic", "clip")


def cell(motion, seed=0):
    return Cell("leaping", "plain", motion, "x1", seed)


def fit(folder, motion, *, psnr=18.0, level=200, pictures=True, seed=0):
    """A cell's results, and its pictures: a person as bright as `level`."""
    write_cell(folder / "metrics", cell(motion, seed), psnr)
    if not pictures:
        return
    write_pictures(folder / "data", cell(motion, seed), level)


def forget_pictures(folder):
    shutil.rmtree(folder / "data")


def gather(folder, **changes):
    plan = small_plan(**changes)
    found = read_cells(plan, folder / "metrics")
    lines = gather_strips(plan, found, folder / "data", folder / "kept")
    return lines, current_strips(folder / "kept", found, "leaping", "plain")


def brightness(strips, motion):
    return read_picture(strips.picture(0, motion)).max()


@pytest.fixture
def folder(tmp_path):
    for motion in MOTIONS:
        fit(tmp_path, motion)
    gather(tmp_path)
    return tmp_path


def test_pictures_of_what_was_fitted_here_are_kept(tmp_path):
    for motion in MOTIONS:
        fit(tmp_path, motion)
    fit(tmp_path, "oracle")
    lines, strips = gather(tmp_path)
    assert lines == ["leaping, plain: agnostic, clip"]
    assert strips.fits == dict.fromkeys(MOTIONS, 18.0)
    assert strips.captions[0].startswith("camera test1, frame 3")


def test_pictures_fitted_elsewhere_stay(folder):
    forget_pictures(folder)
    lines, strips = gather(folder)
    assert lines == []
    assert strips.fits.keys() == set(MOTIONS)


def test_one_motion_fitted_here_drops_no_other(folder):
    forget_pictures(folder)
    fit(folder, "clip", level=120)
    lines, strips = gather(folder)
    assert lines == []
    assert strips.fits.keys() == set(MOTIONS)
    assert brightness(strips, "clip") > 180


def test_all_motions_fitted_again_take_their_place(folder):
    for motion in MOTIONS:
        fit(folder, motion, psnr=18.5, level=120)
    lines, strips = gather(folder)
    assert lines == ["leaping, plain: agnostic, clip"]
    assert strips.fits == dict.fromkeys(MOTIONS, 18.5)
    assert brightness(strips, "clip") < 180


def test_pictures_of_another_fit_than_the_tables_are_not_shown(folder):
    forget_pictures(folder)
    fit(folder, "clip", psnr=18.01, pictures=False)
    lines, strips = gather(folder)
    assert lines == []
    assert strips.fits.keys() == {"agnostic"}
    assert read_strips(folder / "kept/leaping/plain").fits.keys() == set(MOTIONS)


def test_what_is_of_another_fit_does_not_stand_in_the_way(folder):
    forget_pictures(folder)
    fit(folder, "agnostic", psnr=17.0, pictures=False)
    fit(folder, "clip", psnr=18.5, level=120)
    _, strips = gather(folder)
    assert strips.fits == {"clip": 18.5}


def test_the_first_seed_is_shown(tmp_path):
    fit(tmp_path, "clip", level=200)
    fit(tmp_path, "clip", level=120, seed=1)
    _, strips = gather(tmp_path)
    assert brightness(strips, "clip") > 180


def test_scenes_without_pictures_have_none(tmp_path):
    fit(tmp_path, "clip")
    lines, strips = gather(tmp_path, without_pictures=["leaping"])
    assert (lines, strips) == ([], None)
    assert not list((tmp_path / "kept").iterdir())
