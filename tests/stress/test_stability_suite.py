"""The stability suite on one tiny scene: filmed, damaged, fitted, judged and shown."""

import json
import logging

import pytest
import torch

from benchmarks.stress.fit import FitSetup
from benchmarks.stress.measures import mean_of_draws
from benchmarks.stress.params import (
    ModeParams,
    SeverityParams,
    StabilitySceneParams,
)
from benchmarks.stress.report import report_stability
from benchmarks.stress.scene import film_scene, measure_ceiling
from benchmarks.stress.suite import (
    PICTURES,
    run_mode,
    scenes_in,
)
from deblur_avatar.config.reading import (
    load_params,
    parse,
    read_params,
)
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.parameters import MethodParams
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.schedule import ScheduleParams
from tests.structure.pipeline_files import ROOT

PARAMS = ROOT / "stability/params.yaml"
METHODS = ("agnostic", "paper", "lean")
CPU = torch.device("cpu")
SCHEDULE = ScheduleParams(
    warmup=6, trajectory=10, fusion=14, gaussians=200, image_height=32, levels=()
)
SEVERITIES = {
    "seeds": ("seed 0", {"scene": "turn", "damage": {}, "fit": {}}),
    "noise_iid": ("6 degrees", {"scene": "turn", "damage": {"noise_iid_degrees": 6.0}, "fit": {}}),
    "degenerate_gaussians": (
        "thin", {"scene": "turn", "damage": {}, "fit": {"degenerate": 0.05}},
    ),
    "masks_empty": ("all", {"scene": "turn", "damage": {"masks_all_black": 0.0}, "fit": {}}),
    "degenerate_cameras": (
        "behind", {"scene": "turn", "damage": {"body_behind_camera": 0.0}, "fit": {}},
    ),
    "direction": ("one", {"scene": "turn", "damage": {"first_frames": 1.0}, "fit": {}}),
}  # fmt: skip


@pytest.fixture(scope="module")
def modes():
    return {
        name: ModeParams(title=name, severities={label: SeverityParams(**severity)})
        for name, (label, severity) in SEVERITIES.items()
    }


@pytest.fixture(scope="module")
def recipe():
    return load_params(PARAMS, "avatars.lean", RecipeParams)


def scene_params(**changes):
    scene = load_params(PARAMS, "scenes.turn_33", StabilitySceneParams)
    small = {"frames": 12, "image_size": 32, "test_cameras": 1, "test_stride": 4, "window": 17,
             "samples_per_axis": 1}  # fmt: skip
    clip = scene.clip.model_copy(update=small | changes)
    return scene.model_copy(update={"clip": clip})


def setup(recipe, method):
    params = load_params(PARAMS, f"methods.{method}", MethodParams)
    return FitSetup(recipe, params, SCHEDULE, validation_stride=10, seed=0, device=CPU)


@pytest.fixture(scope="module")
def suite(tmp_path_factory, modes, recipe):
    """All of the suite's stages in one process."""
    folder = tmp_path_factory.mktemp("suite")
    body, clip, reference = film_scene(scene_params(), torch.Generator().manual_seed(0))
    numbers = measure_ceiling(clip, reference, body, setup(recipe, "ceiling"), draws=2)
    clip.save(folder / "scene/turn/clip")
    reference.save(folder / "scene/turn/reference")
    (folder / "scene/turn/ceiling.json").write_text(json.dumps(numbers))
    for method in METHODS:
        for mode in modes:
            _run(folder, modes[mode], method, recipe).save(folder / f"item/{mode}-{method}")
    return folder


def _run(folder, mode, method, recipe):
    return run_mode(mode, setup(recipe, method), scenes_in(folder / "scene"))


@pytest.fixture(scope="module")
def report(suite, modes):
    return report_stability(modes, suite / "item", suite / "scene")


def rows(suite, mode, method):
    (row,) = json.loads((suite / f"item/{mode}-{method}/measured.json").read_text()).values()
    return row


@pytest.mark.parametrize("method", METHODS)
def test_nothing_falls_over_and_every_number_is_there(suite, method):
    for mode in SEVERITIES:
        row = rows(suite, mode, method)
        assert row["crashed"] is None, row["crashed"]
        if row["refused"] is None:
            assert row["finite"]
            assert row["score"] > 5
    assert (suite / f"item/seeds-{method}/{PICTURES[0]}.png").is_file()


@pytest.mark.parametrize("method", METHODS)
def test_what_cannot_be_fitted_is_refused_with_a_message(suite, method):
    assert "no frame shows a person" in rows(suite, "masks_empty", method)["refused"]
    assert "the body is behind it" in rows(suite, "degenerate_cameras", method)["refused"]


def test_no_clock_has_a_say_in_what_modes_depend_on(suite):
    assert "seconds" not in json.loads((suite / "scene/turn/ceiling.json").read_text())


def test_a_single_frame_has_no_trajectory_but_an_avatar(suite):
    assert "two frames or more" in rows(suite, "direction", "lean")["refused"]
    assert rows(suite, "direction", "agnostic")["refused"] is None


def test_the_same_item_twice_is_the_same_bytes(suite, modes, recipe):
    again = _run(suite, modes["seeds"], "lean", recipe)
    assert again.rows["seed 0"]["digest"] == rows(suite, "seeds", "lean")["digest"]


def test_the_report_counts_what_the_rules_say(report, suite, tmp_path):
    summary = report.summary
    assert summary["modes"] == len(SEVERITIES)
    for method in METHODS:
        passed = [mode for mode in SEVERITIES if report.metrics[f"{mode}-{method}"]["passed"]]
        assert summary["passed"][method] == len(passed)
        assert {"masks_empty", "degenerate_cameras"} <= set(passed)
    report.save(tmp_path / "reports", tmp_path / "metrics")
    page = (tmp_path / "reports/index.html").read_text()
    assert page.count("<section id=") == len(SEVERITIES)
    assert "data:image/jpeg" in page
    assert "<script" not in page
    assert "http" not in page
    assert len(list((tmp_path / "metrics").iterdir())) == len(SEVERITIES) * len(METHODS)


def test_a_red_field_says_why(suite, modes):
    item = suite / "item/noise_iid-lean/measured.json"
    before = item.read_text()
    content = json.loads(before)
    content["6 degrees"]["joint_error_mm"] = 99.0
    item.write_text(json.dumps(content))
    try:
        judged = report_stability(modes, suite / "item", suite / "scene")
    finally:
        item.write_text(before)
    verdict = judged.metrics["noise_iid-lean"]
    assert not verdict["passed"]
    assert "at 6 degrees, joint error, as a share" in verdict["sentence"]
    assert "\u2717" in judged.page


def test_rules_need_the_clean_scene(modes, tmp_path):
    with pytest.raises(ArtifactError, match="no seeds-agnostic"):
        report_stability(modes, tmp_path, tmp_path)


def test_a_crash_is_kept_as_a_finding(suite, recipe, monkeypatch, modes, caplog):
    def fall(*_, **__):
        raise IndexError("off the end")

    monkeypatch.setattr("benchmarks.stress.suite.fit_method", fall)
    with caplog.at_level(logging.CRITICAL):
        item = _run(suite, modes["seeds"], "lean", recipe)
    assert item.rows["seed 0"]["crashed"] == "IndexError: off the end"
    assert item.worst is None


def test_several_draws_are_averaged_and_the_worst_one_is_shown(suite, recipe, modes, caplog):
    def severity(**fit):
        return SeverityParams(scene="turn", damage={}, fit=fit)

    asked = {
        "1": severity(seed=1.0),
        "2": severity(seed=2.0),
        "both": severity(seed=1.0, draws=2.0),
    }
    with caplog.at_level(logging.CRITICAL):
        item = _run(suite, ModeParams(title="x", severities=asked), "lean", recipe)
    first, second, both = item.rows.values()
    assert both["scores"] == [first["score"], second["score"]]
    assert first["score"] != second["score"]
    for name in ("score", "joint_error_mm", "area_error"):
        assert both[name] == pytest.approx((first[name] + second[name]) / 2)
    assert item.worst.numbers["score"] == min(both["scores"])


def test_the_same_recipe_on_sharp_frames_stands_beside(suite, recipe, modes):
    severity = SeverityParams(scene="turn", damage={}, fit={"oracle": 1.0, "draws": 2.0})
    mode = ModeParams(title="x", severities={"a": severity})
    agnostic = _run(suite, mode, "agnostic", recipe).rows["a"]
    assert len(agnostic["oracle"]["scores"]) == 2
    assert agnostic["oracle"]["digest"] != agnostic["digest"]
    assert agnostic["oracle"]["initial_joint_error_mm"] == agnostic["initial_joint_error_mm"]
    assert "oracle" not in _run(suite, mode, "lean", recipe).rows["a"]


def test_what_one_draw_could_not_measure_has_no_mean():
    row = mean_of_draws(
        [{"score": 1.0, "a": 2.0, "b": True}, {"score": 3.0, "a": None, "b": False}]
    )
    assert row == {"score": 2.0, "a": None, "b": False, "scores": [1.0, 3.0]}


def test_what_a_severity_asks_for_must_exist(suite, recipe, modes):
    severity = SeverityParams(scene="turn", damage={}, fit={"speed": 1.0})
    with pytest.raises(ConfigError, match="fit has no \\['speed'\\]"):
        _run(suite, ModeParams(title="x", severities={"a": severity}), "lean", recipe)


def test_a_method_without_a_shutter_is_left_out(suite, recipe):
    severity = SeverityParams(scene="turn", damage={}, fit={"estimated_shutter": 1.0})
    item = _run(suite, ModeParams(title="x", severities={"a": severity}), "agnostic", recipe)
    assert list(item.rows["a"]) == ["skipped"]


def test_an_estimated_shutter_is_told(suite, recipe):
    severity = SeverityParams(
        scene="turn", damage={"shutter_times": 2.0},
        fit={"estimated_shutter": 0.02, "shutter_weight": 1e-3},
    )  # fmt: skip
    item = _run(suite, ModeParams(title="x", severities={"a": severity}), "lean", recipe)
    row = item.rows["a"]
    assert row["given_exposure_s"] == pytest.approx(2 * 17 / 480)
    assert 0 < row["shutter_s"] != row["given_exposure_s"]


def test_clothes_swing_though_no_joint_moves_them():
    def film(cloth_m):
        params = scene_params(frames=9, window=1).model_copy(update={"cloth_m": cloth_m})
        return film_scene(params, torch.Generator().manual_seed(0))[1]

    still, swung = film(0.0), film(0.1)
    assert torch.equal(still.exact.body_pose, swung.exact.body_pose)
    assert not torch.equal(still.frames, swung.frames)
    upper = slice(0, 12)  # head and chest of a picture of 32 rows
    torch.testing.assert_close(still.frames[:, :, upper], swung.frames[:, :, upper])


def test_the_pipeline_runs_every_mode_of_the_parameters_with_every_method():
    content = read_params(PARAMS)
    for method in METHODS:
        pipeline = read_params(ROOT / "stability" / method / "dvc.yaml")
        assert pipeline["vars"] == ["../params.yaml:modes", {"method": method}]
        stage = pipeline["stages"]["stability"]
        assert stage["foreach"] == "${modes}"
        assert "--mode ${key} --method ${method} " in stage["do"]["cmd"]
    used = {s["scene"] for mode in content["modes"].values() for s in mode["severities"].values()}
    assert used == set(content["scenes"])
    for mode in content["modes"]:
        parse(ModeParams, content["modes"][mode], mode)
    for scene in content["scenes"]:
        parse(StabilitySceneParams, content["scenes"][scene], scene)
