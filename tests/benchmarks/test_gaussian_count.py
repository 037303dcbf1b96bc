"""Tests of the benchmark of Gaussian counts: what it fits, what it calls enough, what it draws."""

from pathlib import Path

from benchmarks import gaussian_count as module
from benchmarks.gaussian_count import chart, record_of, row_of
from deblur_avatar.reporting.charts import drawn
from deblur_avatar.training.schedule import ScheduleParams

SCHEDULE = ScheduleParams(
    warmup=2, trajectory=4, fusion=6, gaussians=1000, image_height=24, levels=()
)


def row(asked: int, seen: float) -> dict[str, float]:
    return {
        "asked": asked, "gaussians": asked + 7, "processor_seconds": 1.0,
        "psnr_seen": seen, "psnr_validation": 30.0,
    }  # fmt: skip


def test_a_fit_has_gaussians_in_proportion_to_what_is_asked_for(monkeypatch, filmed):
    monkeypatch.setattr(module, "filmed", lambda size, folder: (filmed, None))
    monkeypatch.setattr(module, "psnr_seen", lambda *_: 15.0)
    monkeypatch.setattr(module, "load_params", _with(SCHEDULE, module.load_params))
    few, more = (row_of(count, "fine", Path()) for count in (40, 80))
    assert more["gaussians"] == 2 * few["gaussians"]  # densification adds its share
    assert (few["asked"], more["asked"], few["psnr_seen"]) == (40, 80, 15.0)
    assert few["psnr_validation"] != more["psnr_validation"]
    assert few["processor_seconds"] >= 0


def _with(schedule, load):
    def loaded(path, key, kind):
        return schedule if kind is ScheduleParams else load(path, key, kind)

    return loaded


def test_the_smallest_number_within_a_tenth_of_the_best_is_enough():
    record = record_of([row(30, 17.0), row(10, 16.0), row(20, 16.95), row(45, 17.02)], "fine")
    assert [r["asked"] for r in record["rows"]] == [10, 20, 30, 45]
    assert record["smallest_within_0.1_db"] == 20
    assert record_of([row(30, 17.0), row(20, 16.8)], "fine")["smallest_within_0.1_db"] == 30


def test_the_chart_has_a_panel_for_each_measure():
    record = record_of([row(30, 17.0), row(10, 16.0)], "fine")
    files = drawn("count", lambda: chart(record))
    assert set(files) == {"count.svg", "count.png"}
    for label in module.MEASURES.values():
        assert label.encode() in files["count.svg"]
