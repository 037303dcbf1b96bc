"""Tests of the search for settings: one grid for all, what is fitted next, what is best."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks import settings_search as module
from benchmarks.settings_search import (
    AVATARS,
    GRID,
    MOTIONS,
    Cell,
    _arguments,
    best_together,
    main,
    one_at_a_time,
    own_settings,
    record_of,
    row_of,
    wanted,
    with_settings,
)
from benchmarks.time_to_quality import settings_of
from deblur_avatar.training.schedule import ScheduleParams

SCHEDULE = ScheduleParams(
    warmup=2, trajectory=4, fusion=6, gaussians=40, image_height=24, levels=()
)


def row(scene, settings, score, motion="paper"):
    return {
        "scene": scene, "avatar": "plain", "motion": motion, "settings": dict(settings),
        "psnr_validation": score, "gaussians": 10, "processor_seconds": 1.0,
    }  # fmt: skip


def asked(scenes=("a", "b"), motions=("paper",)):
    return SimpleNamespace(
        avatars=["plain"], motions=list(motions), scenes=dict.fromkeys(scenes, Path())
    )


@pytest.mark.parametrize("avatar", AVATARS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_every_search_has_the_same_values_and_as_many_fits(avatar, motion):
    own = own_settings(*settings_of(MOTIONS[motion], AVATARS[avatar]))
    assert list(own) == list(GRID)
    assert all(own[name] in values for name, values in GRID.items())
    fits = list(one_at_a_time(own))
    assert len(fits) == 1 + sum(len(values) - 1 for values in GRID.values())
    assert fits[0] == own
    assert all(sum(one[name] != own[name] for name in GRID) == 1 for one in fits[1:])


@pytest.mark.parametrize("motion", MOTIONS)
def test_other_settings_are_what_is_fitted_and_nothing_else_changes(motion):
    recipe, method = settings_of(MOTIONS[motion], AVATARS["networks"])
    settings = {"features": 0.02, "max_growth": 2.0, "transl": 1e-3, "poses": 1e-2}
    others = with_settings(recipe, method, settings)
    assert own_settings(*others) == settings
    assert with_settings(*others, own_settings(recipe, method)) == (recipe, method)


def test_the_best_value_of_each_setting_is_taken():
    own = own_settings(*settings_of("paper", "lean"))
    scores = {tuple(one.values()): 30.0 for one in one_at_a_time(own)}
    scores[tuple({**own, "poses": 1.0e-2}.values())] = 30.4
    scores[tuple({**own, "features": 5.0e-3}.values())] = 30.1
    scores[tuple({**own, "transl": 1.0e-3}.values())] = 29.0
    assert best_together(own, scores) == {**own, "poses": 1.0e-2, "features": 5.0e-3}


def test_the_best_together_is_fitted_once_all_single_changes_are_known():
    own = own_settings(*settings_of("paper", "lean"))
    first = wanted(asked(), [])
    assert len(first) == 2 * 9
    rows = [
        row(scene, one, 31.0 if one["poses"] == 1.0e-2 else 30.0)
        for scene in "ab" for one in one_at_a_time(own)
    ]  # fmt: skip
    assert len(wanted(asked(), rows[:-1])) == 1  # of the last scene, the last change
    assert wanted(asked(), rows) == []  # the best of each together is a single change here
    rows = [
        {**one, "psnr_validation": 31.0} if one["settings"]["transl"] == 1.0e-3 else one
        for one in rows
    ]
    both = {**own, "poses": 1.0e-2, "transl": 1.0e-3}
    assert wanted(asked(), rows) == [
        Cell(scene, "plain", "paper", tuple(both.values())) for scene in "ab"
    ]


def test_a_search_says_what_each_change_brings_over_all_scenes():
    own = own_settings(*settings_of("paper", "lean"))
    better = {**own, "poses": 3.0e-3}
    rows = [
        row(scene, one, level + gain * (one == better))
        for scene, level, gain in (("a", 30.0, 0.5), ("b", 20.0, -0.1))
        for one in one_at_a_time(own)
    ]
    assert record_of(rows[:-1], "short")["searches"] == []  # one is missing
    (search,) = record_of(rows, "short")["searches"]
    assert search["psnr_validation"] == 25.0
    assert search["gain_of"]["poses 0.003"] == 0.2
    assert search["gain_of"]["features 0.001"] == 0.0
    assert search["best_together"] == better
    assert search["gain_together"] == 0.2


def test_a_row_is_of_the_settings_asked_for(monkeypatch, filmed, tmp_path):
    filmed.save(tmp_path / "seen")
    load = module.load_params
    monkeypatch.setattr(
        module, "load_params",
        lambda path, key, kind: SCHEDULE if kind is ScheduleParams else load(path, key, kind),
    )  # fmt: skip
    own = own_settings(*settings_of("agnostic", "lean"))
    fast = {**own, "features": 1.0e-3}
    rows = [
        row_of(
            Cell("a", "plain", "agnostic", tuple(one.values())), {"a": tmp_path / "seen"}, "short"
        ) for one in (own, fast)
    ]  # fmt: skip
    assert [one["settings"] for one in rows] == [own, fast]
    assert rows[0]["psnr_validation"] != rows[1]["psnr_validation"]


def test_a_search_counts_its_own_scenes_whatever_others_were_searched_on():
    rows = [
        row(scene, one, level, motion)
        for motion, scenes in (("paper", {"a": 30.0}), ("clip", {"a": 31.0, "b": 21.0}))
        for scene, level in scenes.items()
        for one in one_at_a_time(own_settings(*settings_of(MOTIONS[motion], AVATARS["plain"])))
    ]
    clip, paper = record_of(rows, "short")["searches"]
    assert (clip["motion"], clip["scenes"], clip["psnr_validation"]) == ("clip", ["a", "b"], 26.0)
    assert (paper["motion"], paper["scenes"], paper["psnr_validation"]) == ("paper", ["a"], 30.0)


def test_a_record_of_another_schedule_is_not_gone_on_with(tmp_path):
    path = tmp_path / "record.json"
    path.write_text(json.dumps({"schedule": "medium", "rows": []}))
    with pytest.raises(SystemExit, match=r"record\.json is of the schedule medium"):
        main(_arguments(["--json", str(path), "--scenes", f"a={tmp_path}"]))
