"""Made-up measurements that pass every rule, and ways to set one quantity of them."""

from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from typing import Any

from benchmarks.stress import quantities as q
from benchmarks.stress.checks import AGNOSTIC, Case, Limit, Quantity
from benchmarks.stress.params import ModeParams, SeverityParams
from deblur_avatar.config.reading import load_params
from tests.structure.pipeline_files import ROOT

MODES: dict[str, ModeParams] = load_params(
    ROOT / "stability/params.yaml", "modes", dict[str, ModeParams]
)
METHODS = ("lean", "paper", AGNOSTIC)
FLAGS = ["view_coverage_degrees", "speed_ratio"]

# What passes everywhere: as good as the ceiling, at poses known perfectly, in no time.
ROW: dict[str, Any] = {
    "finite": True, "refused": None, "crashed": None, "scene": "turn_33", "score": 17.5,
    "psnr": 25.0, "psnr_limbs": 18.0, "psnr_torso": 17.5, "score_novel_pose": 17.0,
    "area_error": 0.0, "joint_error_mm": 5.0, "initial_joint_error_mm": 10.0,
    "travel_error_mm": 10.0, "direction_accuracy": 1.0, "virtual_poses": 1.0,
    "chooses_virtual_poses": True, "gaussians": 1000, "mean_scale_mm": 20.0, "sharpness": 0.5,
    "stretch": 1.0, "knots": 1, "hidden": 0.5, "given_exposure_s": 0.1, "shutter_s": None,
    "shutter_std_s": 0.001, "seconds": 2.0, "processor_s": 2.0, "blend_mean": 0.5,
    "blend_correlation": 0.9, "shared_condition_db": 0.0, "digest": "a", "flags": FLAGS,
    "warnings": ["1 frames without a person"],
}  # fmt: skip
# Where ignoring blur does no harm, but takes as long and knows no travel.
OF_AGNOSTIC = ROW | {
    "psnr_limbs": 16.0, "travel_error_mm": 100.0, "oracle": {"score": 17.6},
}  # fmt: skip
CLEAN = ROW | {"flags": [], "hidden": 0.4}

Change = Callable[[Case, float], Case]


def made_up(severity: SeverityParams, method: str = "lean", before: int = 0) -> Case:
    """A case that breaks no rule."""
    row: dict[str, Any] = deepcopy(ROW)
    if "estimated_shutter" in severity.fit:
        given = row["given_exposure_s"]
        row["shutter_s"] = given / severity.damage["shutter_times"]
    if severity.damage.get("first_frames") == 1:
        row["direction_accuracy"] = None
    if before:
        row["virtual_poses"] = 1.4
    earlier = ROW | {"virtual_poses": 0.5}
    return Case(
        method=method, severity=severity, row=row, agnostic=OF_AGNOSTIC, ceiling=ROW, clean=CLEAN,
        clean_ceiling=ROW, before=(earlier,) * before,
    )  # fmt: skip


def cases_of(mode: str) -> Iterator[Case]:
    """A case for every severity of a mode and every method that it applies to."""
    for method in METHODS:
        earlier = 0
        for severity in MODES[mode].severities.values():
            estimated = "estimated_shutter" in severity.fit
            asked = not (estimated and method != "lean")
            asked &= not ("networks" in severity.fit and method == "lean")
            asked &= not ({"blend", "instants"} & set(severity.fit) and method == AGNOSTIC)
            if asked:
                yield made_up(severity, method, earlier)
                earlier += 1


def where_it_applies(mode: str, limit: Limit) -> Case | None:
    """A real severity of the mode, and a method, that a limit is asked of."""
    for case in cases_of(mode):
        costly = set_to(q.RECOVERY, case, 1.0) if limit.quantity is q.RECOVERY else case
        if limit.applies(costly):
            return costly
    return None


def set_to(quantity: Quantity, case: Case, value: float) -> Case:
    """The case with one quantity of this value, and nothing else near a limit."""
    return SETTERS[quantity](case, value)


def _with(part: str, **numbers: Any) -> Callable[[Case], Case]:
    """Other numbers in one of a case's rows."""
    return lambda case: replace(case, **{part: {**getattr(case, part), **numbers}})


def _row(key: str, scale: float = 1.0) -> Change:
    return lambda case, value: _with("row", **{key: value * scale})(case)


def _share_of(part: str, key: str) -> Change:
    return lambda case, value: _with("row", **{key: value * getattr(case, part)[key]})(case)


def _above(key: str) -> Change:
    return lambda case, value: _with("agnostic", **{key: case.row[key] - value})(case)


def _recovery(case: Case, value: float) -> Case:
    """Blur costs two decibels, of which so many are won back."""
    floor = case.row["score"] - 2.0 * value
    return _with("agnostic", score=floor, oracle={"score": floor + 2.0})(case)


def _lost(case: Case, value: float) -> Case:
    """The clean scene's gap is that of this case, less so many decibels."""
    return _with("clean", score=case.clean_ceiling["score"] + value)(case)


def _earlier(index: int, key: str, sign: float) -> Change:
    def change(case: Case, value: float) -> Case:
        rows = list(case.before)
        rows[index] = {**rows[index], key: case.row[key] + sign * value}
        return replace(case, before=tuple(rows))

    return change


def _shutter(case: Case, value: float) -> Case:
    true = case.row["given_exposure_s"] / case.severity.damage["shutter_times"]
    return _with("row", shutter_s=value * true)(case)


def _times_before(case: Case, value: float) -> Case:
    return _with("row", gaussians=value * case.before[-1]["gaussians"])(case)


SETTERS: dict[Quantity, Change] = {
    q.RECOVERY: _recovery,
    q.ABOVE_AGNOSTIC: lambda case, v: _with(
        "agnostic", score=case.row["score"] - v, oracle={"score": case.row["score"] - v + 0.1}
    )(case),
    q.ALL_ABOVE_AGNOSTIC: _above("psnr"),
    q.LIMBS_ABOVE_AGNOSTIC: _above("psnr_limbs"),
    q.TORSO_ABOVE_AGNOSTIC: _above("psnr_torso"),
    q.NOVEL_POSE_ABOVE_AGNOSTIC: _above("score_novel_pose"),
    q.LOST: _lost,
    q.BELOW_CEILING: lambda case, v: _with("ceiling", score=case.row["score"] + v)(case),
    q.TORSO_BELOW_CEILING: lambda case, v: _with("ceiling", psnr_torso=case.row["psnr_torso"] + v)(
        case
    ),
    q.GAIN_FROM_MORE_BLUR: _earlier(-1, "score", -1.0),
    q.APART_FROM_CLEAN: lambda case, v: _with("clean", score=case.row["score"] - v)(case),
    q.LOST_AT_EQUAL_BUDGET: _earlier(0, "score", 1.0),
    q.GAIN_FROM_TRAINING: _earlier(-1, "score", -1.0),
    q.LOST_BY_TRAINING: _earlier(-1, "score", 1.0),
    q.JOINT_ERROR: _row("joint_error_mm"),
    q.JOINT_ERROR_KEPT: lambda case, v: _with(
        "row", joint_error_mm=v * case.row["initial_joint_error_mm"]
    )(case),
    q.JOINT_ERROR_GROWN: _share_of("clean", "joint_error_mm"),
    q.TRAVEL_ERROR: _share_of("agnostic", "travel_error_mm"),
    q.RIGHT_WAY: _row("direction_accuracy"),
    q.KNOTS_BEYOND_FRAMES: lambda case, v: _with("row", knots=case.amount + v)(case),
    q.VIRTUAL_POSES: _row("virtual_poses"),
    q.MORE_VIRTUAL_POSES: _earlier(0, "virtual_poses", -1.0),
    q.SHUTTER: _shutter,
    q.WIDTH: _share_of("ceiling", "mean_scale_mm"),
    q.SHARPNESS: _share_of("ceiling", "sharpness"),
    q.AREA: _row("area_error"),
    q.STRETCH: _row("stretch"),
    q.MORE_HIDDEN: lambda case, v: _with("row", hidden=case.clean["hidden"] + v)(case),
    q.GAUSSIANS: _times_before,
    q.TIME: _share_of("agnostic", "processor_s"),
    q.BLEND: _row("blend_mean"),
    q.BLEND_WHERE_BLURRED: _row("blend_correlation"),
    q.SHARED_CONDITION: _row("shared_condition_db"),
}
