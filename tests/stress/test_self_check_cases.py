import dataclasses

import pytest
import torch

from benchmarks.stress.damage import DAMAGES
from benchmarks.stress.params import SelfCheckParams
from benchmarks.stress.self_check_cases import (
    CUT_SHORT,
    SPOILT,
    cases_of,
    confusion,
)
from deblur_avatar.config.reading import load_params, read_params
from tests.conftest import colourful
from tests.structure.pipeline_files import ROOT

PARAMS = ROOT / "stability/params.yaml"


@pytest.fixture(scope="module")
def params():
    return load_params(PARAMS, "self_check", SelfCheckParams)


def test_every_case_names_what_there_is(params):
    known = read_params(PARAMS)
    assert set(params.damages) <= {*DAMAGES, *SPOILT, CUT_SHORT}
    assert {*params.tuning, *params.report} <= known["scenes"].keys()
    assert set(params.methods) <= known["methods"].keys()
    assert not set(params.tuning) & set(params.report)


def test_there_are_twenty_good_and_twenty_damaged_cases_or_more(params):
    cases = list(cases_of(params))
    assert len({case.name + str(case.tuning) for case in cases}) == len(cases)
    assert sum(case.damage is None for case in cases) >= 20
    assert sum(case.damage is not None for case in cases) >= 20
    for tuning in (True, False):
        assert {case.damage for case in cases if case.tuning == tuning} == {None, *params.damages}


def row(good, verdict, tuning=False):
    return {"good": good, "verdict": verdict, "tuning": tuning}


def test_a_damaged_avatar_is_caught_if_it_fails_or_is_refused():
    rows = [
        row(True, "ok"), row(True, "warn"), row(True, "fail", tuning=True),
        row(False, "fail"), row(False, "refused"), row(False, "warn"),
        row(False, "ok", tuning=True),
    ]  # fmt: skip
    table = confusion(rows)
    assert {key: table[key] for key in ("good", "damaged", "gross_misses", "false_alarms")} == {
        "good": 3, "damaged": 4, "gross_misses": 2, "false_alarms": 1,
    }  # fmt: skip
    assert table["not_tuned_on"] == {
        "good": 2, "damaged": 3, "gross_misses": 1, "false_alarms": 0,
    }  # fmt: skip
    assert table["cases"] == rows


@pytest.mark.parametrize(("name", "amount"), [("scattered_share", 0.2), ("inflated_times", 6.0)])
def test_spoiling_changes_an_avatar_by_its_amount(body, name, amount):
    avatar = colourful(body, 5).to_artifact(1)
    spoilt = SPOILT[name](avatar, amount)
    if name == "scattered_share":
        moved = (spoilt.means != avatar.means).any(1)
        assert float(moved.float().mean()) == pytest.approx(amount, abs=0.01)
    else:
        torch.testing.assert_close(spoilt.log_scales.exp(), amount * avatar.log_scales.exp())
    assert dataclasses.replace(spoilt, means=avatar.means, log_scales=avatar.log_scales) == avatar
