"""Tests of the benchmark of one-sided clips: what is fitted, what a gain is."""

import json
from pathlib import Path

import pytest

from benchmarks import one_sided as module
from benchmarks.one_sided import SCORES, TURNS, VARIANTS, main, recipe_of, row_of, summary_of
from deblur_avatar.training.schedule import ScheduleParams

SCHEDULE = ScheduleParams(
    warmup=2, trajectory=4, fusion=6, gaussians=40, image_height=24, levels=()
)


def row(scene, variant, seed, **scores):
    return {
        "scene": scene,
        "variant": variant,
        "seed": seed,
        **dict.fromkeys(SCORES, 1.0),
        **scores,
    }


def test_variants_differ_in_what_they_are_named_after():
    lean, filled, one_sided = (recipe_of(variant) for variant in VARIANTS)
    assert (lean.model.kind, filled.model.kind, one_sided.model.kind) == (
        "plain", "one_sided", "one_sided",
    )  # fmt: skip
    assert one_sided.fitting.regularisers.near_body > 0
    held = one_sided.fitting.regularisers.model_copy(update={"near_body": 0.0})
    assert filled.fitting == one_sided.fitting.model_copy(update={"regularisers": held})


def test_a_gain_is_of_the_same_scene_and_seed():
    rows = [
        row("striding", "lean", 0, psnr=20.0), row("striding", "lean", 1, psnr=21.0),
        row("jumping", "lean", 0, psnr=10.0), row("striding", "filled", 1, psnr=21.5),
        row("striding", "one_sided", 0, psnr=20.5), row("jumping", "one_sided", 0, psnr=11.5),
        row("dancing", "one_sided", 0, psnr=90.0),
    ]  # fmt: skip
    summary = summary_of(rows)
    assert summary["lean"]["psnr"] == 17.0
    assert summary["one_sided"]["fits"] == 3
    assert summary["one_sided"]["psnr_gain"] == pytest.approx(1.0)
    assert summary["one_sided"]["psnr_gain_error"] == pytest.approx(0.5)
    assert "psnr_gain" not in summary["filled"]  # one pair says nothing of its error
    assert "psnr_gain" not in summary["lean"]


def test_a_scene_is_filmed_with_its_turn_and_scored_from_other_cameras(monkeypatch, scene):
    asked = []

    def film(params, name, changes, place, size):
        asked.append((name, changes, place.name, size))
        return scene.observations, scene.reference

    monkeypatch.setattr(module, "filmed_scene", film)
    monkeypatch.setenv("DEBLUR_AVATAR_DEVICE", "cpu")
    found = row_of("jumping", "one_sided", 3, Path(), SCHEDULE)
    assert asked == [("jumping", {"turns": TURNS["jumping"]}, "jumping", 192)]
    assert (found["scene"], found["variant"], found["seed"]) == ("jumping", "one_sided", 3)
    assert found["views"] > 0
    assert set(SCORES) <= set(found)


def test_fits_that_a_record_has_are_not_fitted_again(monkeypatch, tmp_path, capsys):
    fits = []

    def fit(scene, variant, seed, folder, schedule):
        fits.append((scene, variant, seed))
        return row(scene, variant, seed)

    monkeypatch.setattr(module, "row_of", fit)
    path = tmp_path / "record.json"
    words = ["--json", str(path), "--scenes", "dancing", "--variants", "lean", "one_sided"]
    main(module._arguments([*words, "--seeds", "0"]))
    main(module._arguments([*words, "--seeds", "0", "1"]))
    assert sorted(fits) == sorted(
        ("dancing", variant, seed) for variant in ("lean", "one_sided") for seed in (0, 1)
    )
    record = json.loads(path.read_text())
    assert len(record["rows"]) == 4
    assert record["summary"] == json.loads(json.dumps(summary_of(record["rows"])))
    with pytest.raises(SystemExit, match="is of the schedule medium"):
        main(module._arguments([*words, "--schedule", "large"]))
