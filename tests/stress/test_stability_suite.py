"""The stability suite on one tiny scene: filmed, damaged, fitted, judged and shown."""

import json
import logging
from dataclasses import replace
from functools import cache

import pytest
import torch

from benchmarks.stress.fit import FitSetup, fit_method
from benchmarks.stress.input import prepare
from benchmarks.stress.measures import mean_of_draws, measure, score_of
from benchmarks.stress.params import (
    ModeParams,
    SeverityParams,
    StabilitySceneParams,
)
from benchmarks.stress.report import report_stability
from benchmarks.stress.scene import film_scene, measure_ceilings
from benchmarks.stress.suite import (
    PICTURES,
    run_mode,
    scenes_in,
)
from deblur_avatar.bodies.capsule import capsule_body
from deblur_avatar.config.reading import (
    load_params,
    parse,
    read_params,
)
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.pipeline import evaluate
from deblur_avatar.training.schedule import ScheduleParams
from tests.embedded_pictures import without_pictures
from tests.structure.pipeline_files import ROOT

PARAMS = ROOT / "stability/params.yaml"
METHODS = ("agnostic", "paper", "lean")
CPU = torch.device("cpu")
SCHEDULE = ScheduleParams(
    warmup=4, trajectory=6, fusion=8, gaussians=200, image_height=32, levels=()
)
SEVERITIES = {
    "seeds": ("clean", {}, {}),
    "noise_iid": ("6 degrees", {"noise_iid_degrees": 6.0}, {}),
    "degenerate_gaussians": ("thin", {}, {"degenerate": 0.05}),
    "masks_empty": ("all", {"masks_all_black": 0.0}, {}),
    "degenerate_cameras": ("behind", {"body_behind_camera": 0.0}, {}),
    "direction": ("one", {"first_frames": 1.0}, {"no_oracle": 1.0}),
    "zero_velocity": ("start is end", {}, {"start_noise": 0.0}),
}


def severity(damage=None, **fit):
    return SeverityParams(scene="turn", level="mild", damage=damage or {}, fit=fit)


def one_mode(**severities):
    return ModeParams(title="x", severities=severities)


@pytest.fixture(scope="module")
def modes():
    return {
        name: ModeParams(title=name, severities={label: severity(damage, **fit)})
        for name, (label, damage, fit) in SEVERITIES.items()
    }


def scene_params(**changes):
    scene = load_params(PARAMS, "scenes.turn_33", StabilitySceneParams)
    small = {"frames": 12, "image_size": 32, "test_cameras": 1, "test_stride": 4, "window": 17,
             "samples_per_axis": 1}  # fmt: skip
    clip = scene.clip.model_copy(update=small | changes)
    return scene.model_copy(update={"clip": clip})


@cache
def parameters_of(method):
    return FitSetup.of(method, PARAMS, 0, CPU)


def setup(method, **changes):
    """Skinning weights are hardly learned beforehand: nothing here depends on them."""
    chosen = parameters_of(method)
    quick = {"schedule": SCHEDULE, "draws": 1}
    if chosen.networks is not None:
        skinning = chosen.networks.model.skinning.model_copy(update={"pretrain": 3})
        model = chosen.networks.model.model_copy(update={"skinning": skinning})
        quick["networks"] = chosen.networks.model_copy(update={"model": model})
    return replace(chosen, **quick | changes)


@pytest.fixture(scope="module", autouse=True)
def speed_measured_once():
    """Nothing here depends on how fast an avatar is drawn."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate, "TIMED_FRAMES", 1)
        yield


@pytest.fixture(scope="module")
def suite(tmp_path_factory, modes):
    """All of the suite's stages in one process."""
    folder = tmp_path_factory.mktemp("suite")
    body, clip, reference = film_scene(scene_params(), torch.Generator().manual_seed(0))
    numbers = measure_ceilings(clip, reference, body, setup("ceiling", draws=2), networks=True)
    clip.save(folder / "scene/turn/clip")
    reference.save(folder / "scene/turn/reference")
    (folder / "scene/turn/ceiling.json").write_text(json.dumps(numbers))
    for method in METHODS:
        for mode in modes:
            _run(folder, modes[mode], method).save(folder / f"item/{mode}-{method}")
    return folder


def _run(folder, mode, method, **changes):
    return run_mode(mode, setup(method, **changes), scenes_in(folder / "scene"))


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
        if "skipped" in row:
            continue
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
    ceilings = json.loads((suite / "scene/turn/ceiling.json").read_text())
    assert set(ceilings) == {"plain", "networks"}
    for ceiling in ceilings.values():
        assert len(ceiling["scores"]) == 2
        assert not {"seconds", "processor_s"} & set(ceiling)


def test_a_single_frame_has_no_trajectory_but_an_avatar(suite):
    assert "two frames or more" in rows(suite, "direction", "lean")["refused"]
    assert rows(suite, "direction", "agnostic")["refused"] is None


def test_the_same_item_twice_is_the_same_bytes(suite, modes):
    again = _run(suite, modes["seeds"], "lean")
    assert again.rows["clean"]["digest"] == rows(suite, "seeds", "lean")["digest"]


def test_the_report_counts_what_the_rules_say(report, suite, tmp_path):
    summary = report.summary
    assert summary["modes"] == len(SEVERITIES)
    for method in METHODS:
        verdicts = [report.metrics[f"{mode}-{method}"]["passed"] for mode in SEVERITIES]
        passed = [mode for mode, verdict in zip(SEVERITIES, verdicts, strict=True) if verdict]
        assert summary["passed"][method] == len(passed)
        assert summary["does_not_apply"][method] == verdicts.count(None)
        assert {"masks_empty", "degenerate_cameras"} <= set(passed)
    report.save(tmp_path / "reports", tmp_path / "metrics")
    page = (tmp_path / "reports/index.html").read_text()
    assert page.count("<section id=") == len(SEVERITIES)
    assert "data:image/jpeg" in page
    assert "<script" not in page
    assert "http" not in without_pictures(page)
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


def test_a_crash_is_kept_as_a_finding(suite, monkeypatch, modes, caplog):
    def fall(*_, **__):
        raise IndexError("off the end")

    monkeypatch.setattr("benchmarks.stress.suite.fit_method", fall)
    with caplog.at_level(logging.CRITICAL):
        item = _run(suite, modes["seeds"], "lean")
    assert item.rows["clean"]["crashed"] == "IndexError: off the end"
    assert item.worst is None


def test_several_draws_are_averaged_and_the_worst_one_is_shown(suite, caplog):
    asked = one_mode(
        one=severity(seed=1.0, no_oracle=1), two=severity(seed=2.0, no_oracle=1),
        both=severity(seed=1.0, draws=2.0, no_oracle=1),
    )  # fmt: skip
    with caplog.at_level(logging.CRITICAL):
        item = _run(suite, asked, "lean")
    first, second, both = item.rows.values()
    assert both["scores"] == [first["score"], second["score"]]
    assert first["score"] != second["score"]
    for name in ("score", "joint_error_mm", "area_error"):
        assert both[name] == pytest.approx((first[name] + second[name]) / 2)
    assert item.worst.numbers["score"] == min(both["scores"])


def test_every_method_has_the_same_draws_where_a_severity_says_nothing(suite):
    for method in METHODS:
        item = _run(suite, one_mode(a=severity(no_oracle=1)), method, draws=2)
        assert len(item.rows["a"]["scores"]) == 2


def test_agnostic_and_lean_stand_beside_themselves_on_sharp_frames(suite):
    mode = one_mode(a=severity(draws=2.0))
    for method in ("agnostic", "lean"):
        row = _run(suite, mode, method).rows["a"]
        assert len(row["oracle"]["scores"]) == 2
        assert row["oracle"]["score"] != row["score"]
    assert "oracle" not in _run(suite, mode, "paper").rows["a"]
    assert "oracle" not in _run(suite, one_mode(a=severity(no_oracle=1)), "lean").rows["a"]


def test_a_bound_is_scored_as_everything_else_is(suite):
    clip, reference = scenes_in(suite / "scene")("turn")
    for damage in ({}, {"averaged_linear": 1.0, "declared_linear": 1.0}):
        seen = prepare(clip, capsule_body(), damage, 32, 10, 0).blurred
        chosen = setup("agnostic")
        fitted = fit_method(seen, chosen, chosen.plain)
        whole = measure(seen, reference, fitted, CPU).numbers["score"]
        assert score_of(seen, reference, fitted, CPU)["score"] == pytest.approx(whole, abs=1e-5)


def test_time_is_that_of_the_processor_while_it_fits(suite, monkeypatch):
    clock = iter([10.0, 13.5])
    monkeypatch.setattr("benchmarks.stress.fit.time.process_time", lambda: next(clock))
    row = _run(suite, one_mode(a=severity(no_oracle=1)), "agnostic").rows["a"]
    assert row["processor_s"] == 3.5


def test_what_one_draw_could_not_measure_has_no_mean():
    row = mean_of_draws(
        [{"score": 1.0, "a": 2.0, "b": True}, {"score": 3.0, "a": None, "b": False}]
    )
    assert row == {"score": 2.0, "a": None, "b": False, "scores": [1.0, 3.0]}


def test_of_several_times_the_shortest_counts():
    draws = [{"score": 1.0, "seconds": 9.0, "processor_s": s} for s in (4.0, 2.0, 3.0)]
    assert mean_of_draws(draws)["processor_s"] == 2.0
    assert mean_of_draws(draws)["score"] == 1.0


def test_what_a_severity_asks_for_must_exist(suite):
    with pytest.raises(ConfigError, match="fit has no \\['speed'\\]"):
        _run(suite, one_mode(a=severity(speed=1.0)), "lean")


@pytest.mark.parametrize(
    ("method", "fit", "why"),
    [
        ("agnostic", {"estimated_shutter": 1.0}, "no shutter to estimate"),
        ("paper", {"estimated_shutter": 1.0}, "no shutter to estimate"),
        ("lean", {"start_noise": 0.0}, "starts without noise"),
        ("agnostic", {"start_noise": 0.0}, "starts without noise"),
        ("lean", {"networks": 1.0}, "an avatar without networks"),
        ("agnostic", {"networks": 1.0, "blend": 1.0}, "no fusion network"),
        ("agnostic", {"networks": 1.0, "instants": 1.0}, "one instant an exposure"),
    ],
)
def test_what_would_change_nothing_for_a_method_is_left_out(suite, method, fit, why):
    (row,) = _run(suite, one_mode(a=severity(**fit)), method).rows.values()
    assert list(row) == ["skipped"]
    assert why in row["skipped"]


def test_harm_that_changed_no_byte_counts_for_nothing(suite, modes):
    item = suite / "item/noise_iid-lean/measured.json"
    before = item.read_text()
    content = json.loads(before)
    content["6 degrees"]["digest"] = rows(suite, "seeds", "lean")["digest"]
    item.write_text(json.dumps(content))
    try:
        judged = report_stability(modes, suite / "item", suite / "scene")
    finally:
        item.write_text(before)
    verdict = judged.metrics["noise_iid-lean"]
    assert verdict["passed"] is None
    assert "changed nothing" in verdict["severities"]["6 degrees"]["checks"][0]
    assert judged.summary["does_not_apply"]["lean"] == 2  # zero_velocity, too


def test_a_mode_that_applies_to_nothing_is_not_passed(report):
    assert report.metrics["zero_velocity-lean"]["passed"] is None
    assert report.metrics["zero_velocity-paper"]["passed"] is not None
    assert "zero_velocity" not in report.summary["failed_though_agnostic_passes"]["lean"]


def test_a_way_to_fit_that_agnostic_has_not_is_compared_with_its_clean_scene(report, suite):
    entry = report.metrics["zero_velocity-paper"]["severities"]["start is end"]
    assert entry["agnostic"] == rows(suite, "seeds", "agnostic")["score"]


def test_an_estimated_shutter_is_told(suite):
    estimated = severity(
        {"shutter_times": 2.0}, estimated_shutter=0.02, shutter_weight=1e-3, no_oracle=1
    )
    row = _run(suite, one_mode(a=estimated), "lean").rows["a"]
    assert row["given_exposure_s"] == pytest.approx(2 * 17 / 480)
    assert 0 < row["shutter_s"] != row["given_exposure_s"]


def test_networks_are_measured_with_their_own_avatar_and_ceiling(suite):
    folder = suite / "with_networks"
    params = one_mode(**{"clean, networks": severity(networks=1, no_oracle=1)})
    for method in ("agnostic", "paper"):
        item = _run(suite, params, method)
        item.save(folder / f"seeds-{method}")
        assert item.rows["clean, networks"]["shared_condition_db"] is None or method == "paper"
    judged = report_stability({"seeds": params}, folder, suite / "scene")
    ceilings = json.loads((suite / "scene/turn/ceiling.json").read_text())
    entry = judged.metrics["seeds-paper"]["severities"]["clean, networks"]
    assert entry["ceiling"] == ceilings["networks"]["score"] != ceilings["plain"]["score"]


def test_clothes_swing_though_no_joint_moves_them():
    def film(**cloth):
        params = scene_params(frames=9, window=1).model_copy(update=cloth)
        return film_scene(params, torch.Generator().manual_seed(0))[1]

    still, swung, pulled = film(), film(cloth_m=0.1), film(pulled_m=0.1)
    assert not torch.equal(swung.frames, pulled.frames)
    assert not torch.equal(still.frames, pulled.frames)
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
    checked = {*content["self_check"]["tuning"], *content["self_check"]["report"]}
    assert used | checked == set(content["scenes"])
    with_networks = {
        s["scene"] for m in content["modes"].values() for s in m["severities"].values()
        if "networks" in s["fit"]
    }  # fmt: skip
    assert with_networks == {name for name, s in content["scenes"].items() if s["networks"]}
    for mode in content["modes"]:
        parse(ModeParams, content["modes"][mode], mode)
    for scene in content["scenes"]:
        parse(StabilitySceneParams, content["scenes"][scene], scene)
