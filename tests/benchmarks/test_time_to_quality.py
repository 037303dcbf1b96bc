"""Tests of the benchmark of time to quality: what it keeps, and when it calls a fit good."""

import json
from pathlib import Path

import pytest
import torch

from benchmarks import time_to_quality as module
from benchmarks.time_to_quality import Kept, fitted, row_of, settings_of, with_rows
from deblur_avatar.training import trainer
from deblur_avatar.training.schedule import ScheduleParams

ROOT = Path(__file__).parents[2]
SCHEDULE = ScheduleParams(
    warmup=4, trajectory=8, fusion=12, gaussians=60, image_height=24, levels=()
)


@pytest.fixture(autouse=True)
def _on_the_processor(monkeypatch):
    monkeypatch.setenv("DEBLUR_AVATAR_DEVICE", "cpu")


def test_avatars_are_kept_on_the_way_with_what_they_took(filmed):
    kept = fitted(filmed, *settings_of("lean"), SCHEDULE, frozenset({2, 6, 10}))
    assert [one.avatar.iteration for one in kept] == [2, 6, 10, 12]
    seconds = [one.seconds for one in kept]
    assert seconds == sorted(seconds)
    assert seconds[0] > 0
    assert all(one.processor_seconds > 0 for one in kept)


GPU = pytest.param("cuda", marks=[
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here"),
])  # fmt: skip


@pytest.mark.parametrize("device", ["cpu", GPU])
def test_a_reference_that_was_stopped_goes_on_and_ends_with_the_same_avatar(
    device, monkeypatch, filmed, tmp_path, caplog
):
    monkeypatch.setenv("DEBLUR_AVATAR_DEVICE", device)
    monkeypatch.setattr(module.RunFolder, "due", lambda folder: True)
    monkeypatch.setattr(trainer, "NEIGHBOUR_REFRESH", 2)
    whole = fitted(filmed, *settings_of("lean"), SCHEDULE, frozenset())[-1].avatar

    def stopped(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as on_the_way:
        on_the_way.setattr(module, "fuse", stopped)
        with pytest.raises(KeyboardInterrupt):
            fitted(filmed, *settings_of("lean"), SCHEDULE, frozenset(), tmp_path)
    caplog.set_level("INFO")
    again = fitted(filmed, *settings_of("lean"), SCHEDULE, frozenset(), tmp_path)[-1].avatar
    assert "going on after iteration 7" in caplog.text
    # Sums on a GPU come in any order.
    within = {"atol": 0.0, "rtol": 0.0} if device == "cpu" else {"atol": 5e-3, "rtol": 0.0}
    torch.testing.assert_close(again.means, whole.means, **within)


def test_a_fit_is_good_from_the_first_avatar_near_enough_to_the_reference(monkeypatch, filmed):
    kept = fitted(filmed, *settings_of("lean"), SCHEDULE, frozenset({6}))
    moments = [Kept(float(s), 2.0 * s, kept[0].avatar, kept[0].motion) for s in (1, 2, 3)]
    scores = iter([15.0, 15.9, 16.2])
    monkeypatch.setattr(module, "filmed", lambda size, folder: (filmed, None))
    monkeypatch.setattr(module, "fitted", lambda *_, **__: moments)
    monkeypatch.setattr(module, "psnr_seen", lambda *_: next(scores))
    row = row_of("lean", 512, Path(), {"studio-512-lean": 16.05}, "large")
    assert row["seconds_to_within_0.2_db"] == 2.0
    assert row["processor_seconds_to_within_0.2_db"] == 4.0
    assert row["curve"] == [[1.0, 15.0], [2.0, 15.9], [3.0, 16.2]]
    assert row["final_psnr_seen"] == 16.2
    scores = iter([15.0, 15.9, 16.2])
    far = row_of("lean", 512, Path(), {"studio-512-lean": 18.0}, "large")
    assert far["seconds_to_within_0.2_db"] is None
    scores = iter([15.0, 15.9, 16.2])
    unknown = row_of("lean", 512, Path(), {}, "fine")
    assert (far["schedule"], unknown["schedule"]) == ("large", "fine")
    assert far["iterations"] < unknown["iterations"]
    assert (unknown["reference_psnr_seen"], unknown["seconds_to_within_0.2_db"]) == (None, None)


def test_another_seed_fits_another_avatar(filmed):
    first, second = (
        fitted(filmed, *settings_of("lean"), SCHEDULE, frozenset(), seed=seed)[-1]
        for seed in (0, 1)
    )
    assert not torch.equal(first.avatar.means, second.avatar.means)


def test_sizes_have_schedules_of_their_height():
    for size, name in module.SCHEDULES.items():
        schedule = module.load_params(module.PARAMS, f"schedules.{name}", ScheduleParams)
        assert schedule.image_height == size


def test_new_rows_take_the_place_of_old_ones_of_the_same_size_and_method():
    lean = {
        "scene": "studio", "size": 512, "method": "lean", "schedule": "large",
        "reference_psnr_seen": None,
    }  # fmt: skip
    paper, longer = {**lean, "size": 192, "method": "paper"}, {**lean, "schedule": "fine"}
    record = with_rows({}, [lean | {"final": 1}, longer, paper], 1.2, {})
    record = with_rows(record, [lean | {"final": 2}], None, {})
    assert record["rows"] == [paper, longer, lean | {"final": 2}]
    again = lean | {"seed": 1}
    rows = with_rows(record, [again], None, {})["rows"]
    assert rows == [paper, longer, lean | {"final": 2}, again]
    elsewhere = lean | {"device": "cuda"}
    assert len(with_rows(record, [elsewhere], None, {})["rows"]) == 4
    assert record["beside_another"] == 1.2
    assert with_rows(record, [], 1.1, {})["beside_another"] == 1.1


def test_rows_are_compared_with_a_reference_that_came_after_them():
    row = {
        "scene": "studio", "size": 512, "method": "lean", "curve": [[1.0, 15.0], [2.0, 15.9]],
        "reference_psnr_seen": None, "seconds_to_within_0.2_db": None,
        "processor_seconds_to_within_0.2_db": None,
    }  # fmt: skip
    known = with_rows({}, [row], None, {"studio-512-paper": 15.0})
    assert known["rows"] == [row]
    (found,) = with_rows(known, [], None, {"studio-512-lean": 16.05})["rows"]
    assert (found["reference_psnr_seen"], found["seconds_to_within_0.2_db"]) == (16.05, 2.0)
    (far,) = with_rows(known, [], None, {"studio-512-lean": 16.2})["rows"]
    assert (far["reference_psnr_seen"], far["seconds_to_within_0.2_db"]) == (16.2, None)
    measured = row | {"reference_psnr_seen": 16.05, "processor_seconds_to_within_0.2_db": 4.0}
    assert with_rows({}, [measured], None, {"studio-512-lean": 16.05})["rows"] == [measured]


def test_rows_of_two_machines_never_stand_in_one_record():
    record = with_rows({}, [], None, {})
    record["machine"] = record["machine"] | {"cores": 1000}
    with pytest.raises(SystemExit, match="cores is .*1000.*--json"):
        with_rows(record, [], None, {})


def test_a_record_names_its_machine_and_rows():
    for path in (ROOT / "benchmarks/results").glob("time_to_quality_*cores*.json"):
        record = json.loads(path.read_text())
        assert record["machine"]["cpu"]
        for row in record["rows"]:
            assert row["curve"]
            assert len(row["load_before"]) == 3
            assert row["curve"][-1][1] == row["final_psnr_seen"]
