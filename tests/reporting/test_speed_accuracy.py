import math

import pytest

from deblur_avatar.reporting.speed_accuracy import (
    pareto_front,
    rows_of_methods,
    rows_over_time,
    seconds_to,
    with_speed,
)

FINAL = {"ceiling": (90, 30.0), "oracle": (90, 28.0), "agnostic": (80, 24.0), "paper": (200, 25.0),
         "lean": (100, 27.0), "slow": (300, 26.0)}  # fmt: skip


def result(seconds, psnr):
    return {"image": {"psnr": psnr}, "cost": {"train_s": seconds, "render_fps": 50.0}}


def curve(scores, seconds=(10.0, 100.0)):
    points = [
        {
            "stage": "warmup", "iteration": i, "seconds": s, "image": {"psnr": p},
            "validation_psnr": p + 5,
        }
        for i, (s, p) in enumerate(zip(seconds, scores, strict=True))
    ]  # fmt: skip
    return {"disk_mb": 1.25, "points": points}


@pytest.fixture
def studio():
    results = {method: result(*numbers) for method, numbers in FINAL.items()}
    curves = {"paper": curve((20.0, 25.0)), "lean": curve((23.0, 27.0)),
                 "agnostic": curve((20.0, 24.0))}  # fmt: skip
    return with_speed(results, curves), curves


def test_the_front_is_whoever_is_not_beaten_in_both():
    points = {"a": (1.0, 1.0), "b": (2.0, 3.0), "c": (3.0, 2.0), "d": (3.0, 3.0), "e": (2.0, 3.0)}
    assert pareto_front(points) == ["a", "b", "e"]
    assert pareto_front({}) == []


def test_time_to_a_quality_is_straight_over_the_logarithm_of_time():
    curve = [(10.0, 20.0), (100.0, 24.0), (200.0, 22.0)]
    assert seconds_to(curve, 22.0) == pytest.approx(math.sqrt(1000))
    assert seconds_to(curve, 24.0) == pytest.approx(100.0)
    assert seconds_to(curve, 19.0) == 10.0
    assert seconds_to(curve, 24.1) is None
    assert seconds_to([], 1.0) is None


def test_every_method_is_timed_to_where_paper_ends(studio):
    speeds = {method: result["speed"] for method, result in studio[0].items()}
    assert speeds["paper"]["time_to_paper_s"] == pytest.approx(100.0)
    assert speeds["lean"]["time_to_paper_s"] == pytest.approx(math.sqrt(1000))
    assert speeds["agnostic"]["time_to_paper_s"] is None
    assert speeds["oracle"]["time_to_paper_s"] is None
    assert speeds["lean"]["disk_mb"] == 1.25


def test_bounds_are_not_on_the_front_and_push_nobody_off_it(studio):
    on = [method for method, result in studio[0].items() if result["speed"]["pareto"]]
    assert on == ["agnostic", "lean"]


def test_a_row_for_each_method_of_which_time_and_quality_are_known(studio):
    rows = rows_of_methods({"studio": studio[0], "empty": {"agnostic": {}}})
    assert [row["method"] for row in rows] == [*FINAL]
    assert [row["bound"] for row in rows] == [True, True, False, False, False, False]


def test_a_curve_has_a_row_for_each_snapshot_and_quality(studio):
    rows = rows_over_time({"studio": studio[1]})
    assert len(rows) == 2 * 3 * 2
    novel = [row for row in rows if row["measure"] == "novel views"]
    assert {row["paper_db"] for row in novel} == {25.0}


def test_without_novel_views_curves_are_of_validation_frames():
    untrue = {"mine": {"lean": curve((20.0, 22.0))}}
    for point in untrue["mine"]["lean"]["points"]:
        point["image"] = None
    (measure,) = {row["measure"] for row in rows_over_time(untrue)}
    assert measure == "validation frames"
