"""Rules can fail, and say why."""

from typing import Any, NamedTuple

import pytest

from benchmarks.stress.checks import Case, Check
from benchmarks.stress.params import ModeParams, SeverityParams
from benchmarks.stress.rules import RULES, judge
from deblur_avatar.config.reading import load_params
from tests.structure.pipeline_files import ROOT

FINE = {
    "finite": True, "score": 17.5, "psnr": 25.5, "psnr_limbs": 18.0, "psnr_torso": 17.5,
    "score_novel_pose": 17.0, "area_error": -0.02, "joint_error_mm": 10.0, "virtual_poses": 1.0,
    "initial_joint_error_mm": 16.0, "travel_error_mm": 8.0, "direction_accuracy": 1.0,
    "gaussians": 1800, "mean_scale_mm": 23.5, "stretch": 1.1, "seconds": 2.0, "digest": "a",
    "given_exposure_s": 0.1, "shutter_s": 0.1, "knots": 4, "hidden": 0.34, "flags": [],
    "warnings": [],
}  # fmt: skip
AGNOSTIC = {**FINE, "score": 16.0, "psnr": 24.0, "psnr_limbs": 15.0, "score_novel_pose": 15.5,
         "travel_error_mm": 134.0}  # fmt: skip
CEILING = {**FINE, "score": 18.0, "mean_scale_mm": 23.0}


def case(
    row: dict[str, Any], damage: dict[str, float] | None = None, method: str = "lean", **other: Any
) -> Case:
    severity = SeverityParams(scene="turn", damage=damage or {}, fit=other.pop("fit", {}))
    before = tuple(other.pop("before", ()))
    return Case(method, severity, {**FINE, **row}, AGNOSTIC, CEILING, FINE, before)


def test_recovery_is_told_against_ceiling_and_oracle():
    agnostic = {**AGNOSTIC, "flip_seen": 0.5, "oracle": {"score": 17.0, "flip_seen": 0.3}}
    severity = SeverityParams(scene="turn", damage={}, fit={})
    row = {**FINE, "flip_seen": 0.35}
    told = judge("overlap", Case("lean", severity, row, agnostic, CEILING, FINE, ()))
    values = {check.what: check.value for check in told}
    assert values["recovery"] == pytest.approx(0.75)
    assert values["recovery against the oracle"] == pytest.approx(1.5)
    assert values["recovery of FLIP against the oracle"] == pytest.approx(0.75)


def passes(mode: str, given: Case) -> bool:
    return all(check.passed for check in judge(mode, given))


REFUSED = {"refused": "ArtifactError: no", "finite": None, "score": None}


class Told(NamedTuple):
    """A mode's rule told by two rows: what passes, and what does not."""

    mode: str
    damage: dict[str, float]
    good: dict[str, Any]
    bad: dict[str, Any]


TOLD = [
    Told("large_blur", {}, {}, {"score": 15.8}),
    Told("overlap", {}, {}, {"score": 15.9}),
    Told("gaps", {}, {}, {"travel_error_mm": 150.0}),
    Told("fast_limbs", {"exact_poses": 0.0}, {}, {"psnr_limbs": 15.5}),
    Told("fast_limbs", {"exact_poses": 0.0}, {}, {"psnr_torso": 17.0}),
    Told("self_occlusion", {}, {}, {"psnr_torso": 17.0}),
    Told("loose_cloth", {}, {}, {"psnr_limbs": 14.0}),
    Told("noise_iid", {"noise_iid_degrees": 6.0}, {}, {"joint_error_mm": 17.0}),
    Told("noise_iid", {"noise_iid_degrees": 20.0}, {"flags": ["speed_ratio"]}, {}),
    Told("noise_correlated", {"noise_correlated_degrees": 0.0}, {}, {"joint_error_mm": 11.0}),
    Told("root_noise", {"root_noise_cm": 5.0}, {}, {"joint_error_mm": 17.0}),
    Told("missing_poses", {"no_poses": 0.0}, REFUSED, {}),
    Told("missing_poses", {"missing_poses_share": 0.3}, {}, REFUSED),
    Told("few_frames", {"first_frames": 4.0}, {}, {"knots": 9}),
    Told("narrow_view", {}, {"hidden": 0.5}, {}),
    Told("masks_dilated", {"masks_dilated_px": 1.0}, {}, {"score": 16.9}),
    Told("masks_dilated", {"masks_dilated_px": 4.0}, {"score": 16.9}, {"score": 15.9}),
    Told("masks_eroded", {"masks_eroded_px": 1.0}, {}, {"score": 16.9}),
    Told("masks_holes", {"masks_holes_share": 0.05}, {}, {"score": 16.9}),
    Told("masks_swapped", {"masks_swapped": 3.0}, {}, {"score": 16.9}),
    Told("mask_binary", {"masks_above": 0.0}, {}, {"area_error": 0.2}),
    Told("masks_empty", {"masks_all_black": 0.0}, REFUSED, {}),
    Told("masks_empty", {"masks_black": 1.0}, {"warnings": ["1 frames without a person"]}, {}),
    Told("wrong_shutter", {"shutter_times": 2.0}, {}, {"score": 15.8}),
    Told("reversal_sine", {}, {}, {"psnr_limbs": 14.9}),
    Told("reversal_triangle", {}, {}, {"score": 15.9}),
    Told("direction", {}, {}, {"direction_accuracy": 0.9}),
    Told("direction", {"first_frames": 1.0}, {"direction_accuracy": None}, {}),
    Told("zero_velocity", {}, {}, {"travel_error_mm": 120.0}),
    Told("zero_motion", {}, {}, {"virtual_poses": 5.0}),
    Told("gain_ramp", {"gain_ramp_stops": 1.0}, {}, {"score": 16.4}),
    Told("flicker", {"flicker_share": 0.2}, {}, {"joint_error_mm": 13.0}),
    Told("light_mismatch", {}, {}, {"score": 15.8}),
    Told("clipping", {"clipped_at": 180.0}, {}, {"score": 16.4}),
    Told("extreme_pose", {}, {}, {"stretch": 5.1}),
    Told("degenerate_cameras", {"zero_focal": 0.0}, REFUSED, {}),
    Told("bad_numbers", {"nan_pose_frame": 5.0}, REFUSED, {}),
    Told("degenerate_gaussians", {}, {}, {"finite": False}),
    Told("overtraining", {}, {}, {"score": 17.3}),
    Told("absorbed", {}, {}, {"mean_scale_mm": 26.0}),
    Told("seeds", {}, {}, {"score": 15.9}),
]


@pytest.mark.parametrize("told", TOLD, ids=lambda told: told.mode)
def test_a_rule_tells_good_from_bad(told):
    assert passes(told.mode, case(told.good, told.damage))
    assert not passes(told.mode, case(told.bad, told.damage))


def test_every_rule_is_seen_to_fail_and_every_mode_has_one():
    assert {told.mode for told in TOLD} == set(RULES)
    assert set(RULES) == set(
        load_params(ROOT / "stability/params.yaml", "modes", dict[str, ModeParams])
    )


def test_a_crash_fails_whatever_else_was_asked():
    assert not passes("bad_numbers", case({"crashed": "IndexError: 3", **REFUSED}))


def test_agnostic_is_held_to_limits_of_its_own():
    assert passes("overlap", case({"score": 15.0}, method="agnostic"))
    assert not passes("overlap", case({"score": 14.0}, method="agnostic"))


def test_virtual_poses_must_grow_with_blur():
    few = [{**FINE, "virtual_poses": 3.0, "score": 18.0}]
    assert passes("large_blur", case({"virtual_poses": 6.0}, before=few))
    assert not passes("large_blur", case({"virtual_poses": 3.0}, before=few))


def test_an_estimated_shutter_is_compared_with_the_true_one():
    wrong = {"given_exposure_s": 0.2, "shutter_s": 0.11}
    fit = {"estimated_shutter": 1.0}
    assert passes("wrong_shutter", case(wrong, {"shutter_times": 2.0}, fit=fit))
    assert not passes(
        "wrong_shutter", case(wrong | {"shutter_s": 0.2}, {"shutter_times": 2.0}, fit=fit)
    )


def test_the_same_seed_must_give_the_same_bytes():
    assert not passes("seeds", case({"digest": "b"}, before=[FINE]))
    assert passes("seeds", case({"digest": "b"}, before=[FINE], fit={"seed": 1.0}))


@pytest.mark.parametrize("value", [None, float("nan"), 2.0])
def test_what_was_not_measured_breaks_a_limit(value):
    check = Check("growth", value, maximum=1.0)
    assert not check.passed
    assert check.sentence.endswith("wanted at most 1.00")
