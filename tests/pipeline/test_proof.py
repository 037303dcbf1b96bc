import json
import re

import numpy as np
import pytest

from deblur_avatar.config.proof import MOTIONS, Cell, cells_of
from deblur_avatar.errors import ArtifactError
from deblur_avatar.pipeline.proof import report_proof
from deblur_avatar.reporting.kept_strips import keep_strips
from deblur_avatar.reporting.picture_strips import INPUT, TRUTH, Strip
from tests.evaluation.test_proof_grid import PSNR
from tests.proof_results import PLAN, small_plan, write_cell


def measured(folder):
    for cell in cells_of(small_plan()).values():
        psnr = PSNR[cell.avatar, cell.motion] + cell.seed + 0.3 * (cell.schedule == "x2")
        write_cell(folder, cell, psnr - 0.5 * (cell.scene == "leaping_17"))
    return folder


@pytest.fixture
def metrics(tmp_path):
    return measured(tmp_path / "metrics")


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Of results that nobody changes: the chart takes a second."""
    folder = tmp_path_factory.mktemp("proof")
    return report_proof(small_plan(), measured(folder / "metrics"), folder / "strips")


def test_the_summary_has_every_avatar_and_motion_of_every_scene(report):
    scenes = report.summary["scenes"]
    assert {name: scene["kind"] for name, scene in scenes.items()} == {
        "studio": "tuning", "leaping": "report", "leaping_17": "report",
    }  # fmt: skip
    for scene in scenes.values():
        assert scene["grid"].keys() == {"networks", "plain"}
        assert all(tuple(row) == MOTIONS for row in scene["grid"].values())
    assert scenes["leaping"]["grid"]["plain"]["mad"] is None
    assert scenes["leaping"]["grid"]["networks"]["paper"]["recovery"]["psnr_seen"] == 0.25


def test_a_grid_shows_recovery_below_each_avatar(report):
    assert "| networks | 15.00 | \u2013 | \u2013 | **16.00** |" in report.tables
    assert "| networks: recovery | 0.00 | \u2013 | \u2013 | 0.25 |" in report.tables
    assert "| plain | 16.50 \u00b1 0.71 |" in report.tables


def test_the_headline_has_report_scenes_alone(report):
    titles = [line for line in report.headline.splitlines() if line.startswith("### ")]
    assert len(titles) == 1
    assert titles[0].startswith("### leaping: PSNR seen")
    assert report.headline in report.tables


def test_windows_stand_side_by_side(report):
    section = report.tables.split("### leaping: windows")[1].split("###")[0]
    assert "17 sub-frames" in section
    assert "33 sub-frames" in section
    assert "| plain, clip | 18.50 | 1.50 | 19.50 \u00b1 0.71 | 1.50 \u00b1 0.00 |" in section


def test_the_distance_to_convergence_is_what_doubling_brings(report):
    section = report.tables.split("### studio: PSNR seen by iterations")[1].split("###")[0]
    assert "80 it." in section
    # 19.00, 19.30: doubling brought 0.30, the second half of the longest 0.50.
    assert "| plain, clip | 19.00 | 19.30 | 0.30 | 0.50 |" in section


def test_a_tuning_scene_is_called_one(report):
    assert "settings were chosen on it" in report.page
    assert "made once, run once with frozen settings" in report.page


def test_the_head_counts_what_was_fitted_and_not_what_was_planned(report, metrics, tmp_path):
    assert "2 avatars, " in report.page
    for path in metrics.rglob("*plain-*"):
        path.unlink()
    assert "1 avatars, " in report_proof(small_plan(), metrics, tmp_path / "strips").page


def test_the_chart_has_a_curve_for_every_cell_of_a_scene_that_stands_alone(report):
    rows = json.loads(report.charts["quality_over_time.json"])
    curves = {(row["scene"], row["avatar"], row["motion"]) for row in rows}
    assert len(curves) == 6 + 2
    assert not [row for row in rows if row["scene"] == "leaping_17"]
    assert report.charts["quality_over_time.svg"].startswith(b"<svg")
    assert "<svg" in report.page


def test_equal_results_give_equal_bytes(report, metrics, tmp_path):
    again = report_proof(small_plan(), metrics, tmp_path / "strips")
    assert (again.page, again.tables, again.charts) == (report.page, report.tables, report.charts)


def test_part_of_the_cells_make_a_report_too(tmp_path):
    cell = Cell("leaping_17", "plain", "clip", "x1", 0)
    write_cell(tmp_path, cell, 19.0, curve=False)
    report = report_proof(small_plan(), tmp_path, tmp_path)
    assert list(report.summary["scenes"]) == ["leaping_17"]
    assert report.charts == {"quality_over_time.json": b"[]\n"}


def test_without_any_cell_it_says_what_to_run(tmp_path):
    with pytest.raises(ArtifactError, match="no results in .*; run `make proof`"):
        report_proof(small_plan(), tmp_path, tmp_path)


def test_a_view_has_a_row_an_avatar_from_the_input_to_the_truth(metrics, tmp_path):
    strips = tmp_path / "reports/strips"
    for avatar, motions in (("plain", ("agnostic", "clip")), ("networks", ("paper",))):
        picture = np.zeros((24, 24, 3), np.uint8)
        fits = {motion: PSNR[avatar, motion] for motion in motions}
        strip = Strip("camera test1", False, dict.fromkeys((INPUT, *motions, TRUTH), picture))
        keep_strips(strips / "leaping" / avatar, [strip], fits)
    report = report_proof(small_plan(), metrics, strips)
    (shown,) = re.findall(r'<div class="strip".*?</div>', report.page, re.S)
    assert "repeat(5, 1fr)" in shown
    rows = [
        "blurred input||networks paper||truth",
        "blurred input|plain agnostic||plain clip|truth",
    ]
    labels = re.findall("((?:<span>[^<]*</span>){5})", shown)
    assert [re.sub("<.span><span>|<.?span>", "|", row).strip("|") for row in labels] == rows
    files = re.findall('src="([^"]*)"', shown)
    assert files[1] == "strips/leaping/networks/0-paper.jpg"
    assert all((tmp_path / "reports" / file).is_file() for file in files)
    assert len(files) == 7
    hidden = small_plan(without_pictures=["leaping"])
    assert "<img" not in report_proof(hidden, metrics, strips).page


def test_real_light_stands_between_and_in_no_mean(metrics, tmp_path):
    scenes = PLAN["scenes"] | {"studio": "real_light"}
    report = report_proof(small_plan(scenes=scenes), metrics, tmp_path / "strips")
    titles = [line for line in report.headline.splitlines() if line.startswith("### ")]
    assert [title.split()[1] for title in titles] == ["leaping:", "studio:"]
    assert "1 report scenes" in report.page
    assert "and 1 in real light" in report.page
    assert "A report scene in real light" in report.page
