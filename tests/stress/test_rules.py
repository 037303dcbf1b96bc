"""Rules can fail, and say why; and no number in their table can be changed unseen."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import pytest

from benchmarks.stress import quantities as q
from benchmarks.stress.checks import AGNOSTIC, Case, Check, Limit, Rule
from benchmarks.stress.params import SeverityParams
from benchmarks.stress.rules import ALL, RULES, judge
from tests.stress.limits_table import PAGE, limits_table, with_table
from tests.stress.rule_cases import (
    MODES,
    OF_AGNOSTIC,
    ROW,
    cases_of,
    made_up,
    set_to,
    where_it_applies,
)

REFUSED = {"refused": "ArtifactError: no", "finite": None, "score": None}
TINY = 1e-6
SHIFT = 0.1  # of a limit at 0, which ten times is 0 again


def severity(damage: dict[str, float] | None = None, level: str = "mild", **fit: float) -> Any:
    return SeverityParams.model_validate(
        {"scene": "turn_33", "level": level, "damage": damage or {}, "fit": fit}
    )


def case(row: dict[str, Any], damage: dict[str, float] | None = None, **changes: Any) -> Case:
    given = made_up(severity(damage), before=changes.pop("earlier", 0))
    return replace(given, row=given.row | row, **changes)


def passes(mode: str, given: Case, rules: dict[str, Rule] | None = None) -> bool:
    return all(check.passed for check in judge(mode, given, rules))


# --- every limit ----------------------------------------------------------------------------------


class Edge(NamedTuple):
    """One number of one limit of one mode: where it stands in the table."""

    mode: str  # whose severities it is tried at
    key: str  # of `RULES`
    place: int
    side: str

    @property
    def limit(self) -> Limit:
        limit = RULES[self.key][self.place]
        assert isinstance(limit, Limit)
        return limit

    @property
    def number(self) -> float:
        return float(getattr(self.limit, self.side))

    @property
    def beyond(self) -> float:
        """Which way breaks it."""
        return -1.0 if self.side == "minimum" else 1.0

    def mutants(self) -> Iterator[dict[str, Rule]]:
        """The table with this number ten times as large, and a tenth; one at 0 is shifted."""
        ten_times = (10 * self.number, self.number / 10)
        for number in ten_times if self.number else (-SHIFT, SHIFT):
            rows = list(RULES[self.key])
            rows[self.place] = replace(self.limit, **{self.side: number})
            yield {**RULES, self.key: tuple(rows)}


def edges() -> Iterator[Edge]:
    for key, rows in RULES.items():
        mode = "overlap" if key == ALL else key
        for place, limit in enumerate(rows):
            if isinstance(limit, Limit):
                for side in ("minimum", "maximum"):
                    if getattr(limit, side) is not None:
                        yield Edge(mode, key, place, side)


def named(edge: Edge) -> str:
    return f"{edge.key}-{edge.limit.quantity.what}-{edge.side}-{edge.number}".replace(" ", "_")


@pytest.mark.parametrize("edge", list(edges()), ids=named)
def test_no_limit_can_be_changed_unseen(edge):
    given = where_it_applies(edge.mode, edge.limit)
    assert given is not None, "no severity of the suite and no method is ever asked for this"
    inside = set_to(edge.limit.quantity, given, edge.number - edge.beyond * TINY)
    outside = set_to(edge.limit.quantity, given, edge.number + edge.beyond * TINY)
    assert passes(edge.mode, inside), "something else is broken, too"
    assert not passes(edge.mode, outside)
    for mutant in edge.mutants():
        kept = passes(edge.mode, inside, mutant), passes(edge.mode, outside, mutant)
        assert kept != (True, False), "this limit can be another and nobody sees it"


def test_the_edges_are_those_of_the_whole_table():
    assert len(list(edges())) > 60
    assert {edge.key for edge in edges()} >= set(MODES) - {"degenerate_cameras", "bad_numbers"}


@pytest.mark.parametrize("mode", MODES)
def test_measurements_that_are_fine_pass_at_every_severity(mode):
    for given in cases_of(mode):
        refuses = mode in ("degenerate_cameras", "bad_numbers") or (
            {"no_poses", "masks_all_black"} & set(given.severity.damage)
        )
        wanted = replace(given, row=given.row | REFUSED) if refuses else given
        assert passes(mode, wanted), [c.sentence for c in judge(mode, wanted) if not c.passed]


# --- recovery -------------------------------------------------------------------------------------


def costing(cost: float, recovered: float, level: str = "mild", method: str = "lean") -> Case:
    """Blur costs so many decibels, and this share of them is won back."""
    given = made_up(severity(level=level), method)
    agnostic = OF_AGNOSTIC | {"score": 16.0, "oracle": {"score": 16.0 + cost}}
    return replace(given, agnostic=agnostic, row=given.row | {"score": 16.0 + recovered * cost})


def told(given: Case, mode: str = "overlap") -> dict[str, float | None]:
    return {check.what: check.value for check in judge(mode, given)}


# Those that refuse, and one that nothing blurs.
UNBLURRED = ("degenerate_cameras", "bad_numbers", "zero_motion")


@pytest.mark.parametrize("mode", sorted(set(MODES) - set(UNBLURRED)))
@pytest.mark.parametrize("method", ["lean", "paper"])
def test_every_mode_asks_for_recovery_where_blur_costs_enough(mode, method):
    asked = costing(2.0, 0.29, "severe", method)
    recovery = [
        check for check in judge(mode, replace(asked, before=(ROW,))) if check.what == "recovery"
    ]
    assert [(check.minimum, check.passed) for check in recovery] == [(0.3, False)]


@pytest.mark.parametrize(("level", "least"), [("mild", 0.5), ("severe", 0.3)])
def test_more_recovery_is_asked_for_at_mild_levels(level, least):
    assert passes("overlap", costing(2.0, least + TINY, level))
    assert not passes("overlap", costing(2.0, least - TINY, level))


def test_recovery_is_neither_told_nor_asked_for_where_blur_costs_little():
    assert "recovery" in told(costing(0.5, 0.6))
    assert not [what for what in told(costing(0.49, 0.1)) if "recovery" in what]
    assert passes("overlap", costing(0.49, 0.1))


def test_agnostic_is_not_asked_for_recovery():
    assert "recovery" not in told(costing(2.0, 0.0, method=AGNOSTIC))


def test_recovery_is_against_the_better_of_both_oracles():
    given = costing(2.0, 0.6)
    assert told(given)["recovery"] == pytest.approx(0.6)
    own = replace(given, row=given.row | {"oracle": {"score": 20.0}})
    assert told(own)["recovery"] == pytest.approx(1.2 / 4.0)


def test_no_rule_passes_for_want_of_an_oracle():
    given = costing(2.0, 0.6)
    lacking = {key: value for key, value in given.agnostic.items() if key != "oracle"}
    with pytest.raises(KeyError, match="oracle"):
        judge("overlap", replace(given, agnostic=lacking))


def test_the_suite_measures_an_oracle_in_every_mode_with_blur():
    for mode, params in MODES.items():
        with_oracle = [s for s in params.severities.values() if "no_oracle" not in s.fit]
        needless = {"zero_motion", "overtraining", "fusion_collapse", "shared_condition"}
        assert bool(with_oracle) == (mode not in needless), mode


# --- what only some rules ask ---------------------------------------------------------------------


class Told(NamedTuple):
    """What must be so, told by two rows: what passes, and what does not."""

    mode: str
    damage: dict[str, float]
    good: dict[str, Any]
    bad: dict[str, Any]


TOLD = [
    Told("overlap", {}, {}, {"finite": False}),
    Told("degenerate_cameras", {"zero_focal": 0.0}, REFUSED, {}),
    Told("bad_numbers", {"nan_pose_frame": 5.0}, REFUSED, {}),
    Told("missing_poses", {"no_poses": 0.0}, REFUSED, {}),
    Told("missing_poses", {"missing_poses_share": 0.3}, {}, REFUSED),
    Told("masks_empty", {"masks_all_black": 0.0}, REFUSED, {}),
    Told("masks_empty", {"masks_black": 1.0}, {}, {"warnings": ["another thing"]}),
    Told("noise_iid", {"noise_iid_degrees": 20.0}, {"joint_error_mm": 99.0}, {"flags": []}),
    Told("noise_iid", {"noise_iid_degrees": 20.0}, {}, {"flags": ["saturated_share"]}),
    Told("noise_iid", {"noise_iid_degrees": 10.0}, {"flags": []}, {"joint_error_mm": 99.0}),
    Told("direction", {"first_frames": 1.0}, {}, {"direction_accuracy": 1.0}),
    Told("direction", {"first_frames": 1.0}, REFUSED, {"direction_accuracy": 0.0}),
    Told("seeds", {}, {}, {"digest": "b"}),
]  # fmt: skip


@pytest.mark.parametrize("told", TOLD, ids=lambda told: told.mode)
def test_what_must_be_so_is_seen_where_it_is_not(told):
    earlier = int(told.mode == "seeds")
    assert passes(told.mode, case(told.good, told.damage, earlier=earlier))
    assert not passes(told.mode, case(told.bad, told.damage, earlier=earlier))


def test_every_limit_stands_in_the_documentation_with_its_number():
    page = PAGE.read_text()
    assert page == with_table(page, limits_table()), "run python -m tests.stress.limits_table"


def test_bad_masks_may_cost_more_where_they_are_worse():
    for level, passed in (("mild", False), ("severe", True)):
        given = set_to(q.LOST, made_up(severity({"masks_dilated_px": 1.0}, level)), 0.6)
        assert passes("masks_dilated", given) == passed


def test_every_mode_has_a_rule_and_every_rule_a_mode():
    assert set(RULES) - {ALL} == set(MODES)


def test_the_check_must_warn_where_a_whole_side_is_never_seen():
    for level, passed in (("mild", True), ("severe", False)):
        given = made_up(severity(level=level))
        assert passes("narrow_view", given)
        silent = replace(given, row=given.row | {"flags": ["speed_ratio"]})
        assert passes("narrow_view", silent) == passed


def test_a_crash_fails_whatever_else_was_asked():
    assert not passes("bad_numbers", case({"crashed": "IndexError: 3", **REFUSED}))


def test_a_refusal_that_was_not_wanted_says_why():
    (check,) = [c for c in judge("overlap", case(REFUSED)) if "came out" in c.what]
    assert "ArtifactError: no" in check.sentence


@pytest.mark.parametrize("mode", MODES)
def test_agnostic_is_held_to_the_limits_of_the_others(mode):
    for given in cases_of(mode):
        if given.method == AGNOSTIC:
            peers = replace(given, method="paper")
            shared = [check for check in judge(mode, given) if check not in judge(mode, peers)]
            assert shared == []


def test_only_methods_that_choose_their_virtual_poses_are_asked_how_many():
    fixed = {"virtual_poses": 5.0, "chooses_virtual_poses": False}
    assert passes("zero_motion", case(fixed))
    assert not passes("zero_motion", case(fixed | {"chooses_virtual_poses": True}))


def test_another_draw_may_have_other_bytes():
    given = replace(case({"digest": "b"}, earlier=1), severity=severity(seed=2.0))
    assert passes("seeds", given)


@pytest.mark.parametrize("value", [None, float("nan"), 2.0])
def test_what_was_not_measured_breaks_a_limit(value):
    check = Check("growth", value, maximum=1.0)
    assert not check.passed
    assert check.sentence.endswith("wanted at most 1.00")


# --- what the suite compares ----------------------------------------------------------------------

DIFFERENCE_DB = 0.14  # by which two methods' difference scatters on the same draw
TIGHT_DB = 0.1  # of two draws


@pytest.mark.parametrize("mode", MODES)
def test_draws_are_as_many_as_the_tightest_limit_asks_for(mode):
    beside = [
        abs(limit.minimum)
        for limit in RULES[mode]
        if isinstance(limit, Limit) and limit.minimum and limit.quantity is q.ABOVE_AGNOSTIC
    ]
    tight = bool(beside) and min(beside) < TIGHT_DB
    for one in MODES[mode].severities.values():
        if tight:
            assert DIFFERENCE_DB / one.fit["draws"] ** 0.5 <= min(beside)
        else:
            assert one.fit.get("draws", 1) == 1, "more draws for a mode need a tighter limit"


def test_an_estimated_shutter_is_compared_with_the_right_one_in_as_many_iterations():
    first, *others = MODES["wrong_shutter"].severities.values()
    estimated = [other for other in others if "estimated_shutter" in other.fit]
    assert not first.damage
    assert len(estimated) == 2
    for one in estimated:
        assert one.fit["budget"] == first.fit["budget"]
        assert one.scene == first.scene


def test_gain_drifts_under_the_default_recipe():
    assert {} in [one.fit for one in MODES["gain_ramp"].severities.values()]


def test_networks_are_tried_in_six_modes_or_more():
    real = [m for m, p in MODES.items() if any("networks" in s.fit for s in p.severities.values())]
    assert len(real) >= 6
    assert {"absorbed", "fusion_collapse", "shared_condition"} <= set(real)
