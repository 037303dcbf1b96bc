"""Tests of the benchmark of guessed shutters: what is told, what is found, what is kept."""

import json
from pathlib import Path

import pytest

from benchmarks import guessed_shutter as module
from benchmarks.guessed_shutter import SCORES, main, row_of, summary_of, told
from deblur_avatar.training.schedule import ScheduleParams

SCHEDULE = ScheduleParams(
    warmup=2, trajectory=4, fusion=6, gaussians=40, image_height=24, levels=()
)


def row(scene, way, factor, seed, **scores):
    named = {"scene": scene, "way": way, "factor": factor, "seed": seed}
    return named | dict.fromkeys(SCORES, 1.0) | scores


@pytest.mark.parametrize(("way", "guess"), [("believed", False), ("estimated", True)])
def test_a_wrong_shutter_is_told_as_known_or_as_a_guess(scene, way, guess):
    seen = told(scene.observations, way, 2.0)
    assert seen.exposure == pytest.approx(2 * scene.observations.exposure)
    assert (seen.exposure_std is not None) == guess


@pytest.mark.parametrize("way", ["believed", "estimated"])
def test_a_shutter_that_was_believed_stays_and_shares_are_of_the_true_one(monkeypatch, scene, way):
    monkeypatch.setattr(
        module, "filmed_scene", lambda *asked: (scene.observations, scene.reference)
    )
    monkeypatch.setenv("DEBLUR_AVATAR_DEVICE", "cpu")
    found = row_of("striding", way, 0.5, 0, Path(), SCHEDULE)
    assert (found["scene"], found["way"], found["factor"]) == ("striding", way, 0.5)
    assert found["shutter_share"] == pytest.approx(0.5, rel=1e-6 if way == "believed" else 0.3)
    assert found["views"] > 0
    assert set(SCORES) <= set(found)


def test_means_are_of_one_way_and_one_factor():
    rows = [
        row("striding", "believed", 0.5, 0, psnr=20.0),
        row("jumping", "believed", 0.5, 0, psnr=22.0),
        row("striding", "believed", 2.0, 0, psnr=10.0),
        row("striding", "estimated", 0.5, 0, psnr=30.0),
    ]
    summary = summary_of(rows)
    assert summary["believed, 0.5 times"]["psnr"] == 21.0
    assert summary["believed, 0.5 times"]["fits"] == 2
    assert summary["believed, 2 times"]["psnr"] == 10.0
    assert summary["estimated, 0.5 times"]["psnr"] == 30.0


def test_fits_that_a_record_has_are_not_fitted_again(monkeypatch, tmp_path):
    fits = []

    def fit(scene, way, factor, seed, folder, schedule):
        fits.append((way, factor))
        return row(scene, way, factor, seed)

    monkeypatch.setattr(module, "row_of", fit)
    path = tmp_path / "record.json"
    words = ["--json", str(path), "--scenes", "dancing", "--factors"]
    main(module._arguments([*words, "2"]))
    main(module._arguments([*words, "0.5", "2"]))
    assert sorted(fits) == [
        ("believed", 0.5), ("believed", 2.0), ("estimated", 0.5), ("estimated", 2.0),
    ]  # fmt: skip
    record = json.loads(path.read_text())
    assert record["summary"] == json.loads(json.dumps(summary_of(record["rows"])))
    with pytest.raises(SystemExit, match="is of the schedule medium"):
        main(module._arguments([*words, "2", "--schedule", "large"]))
