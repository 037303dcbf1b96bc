import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from deblur_avatar.reporting.speed_accuracy import (
    OVER_TIME,
    SPEED_ACCURACY,
    chart,
    drawn,
    drawn_png,
    pareto_front,
    rows_of_methods,
    rows_over_time,
    seconds_to,
    with_speed,
)

ROOT = Path(__file__).resolve().parents[2]
FINAL = {"ceiling": (90, 30.0), "oracle": (90, 28.0), "agnostic": (80, 24.0), "paper": (200, 25.0),
         "lean": (100, 27.0), "slow": (300, 26.0)}  # fmt: skip


def result(seconds, psnr):
    return {"image": {"psnr": psnr}, "cost": {"train_s": seconds, "render_fps": 50.0}}


def timeline(scores, seconds=(10.0, 100.0)):
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
    timelines = {"paper": timeline((20.0, 25.0)), "lean": timeline((23.0, 27.0)),
                 "agnostic": timeline((20.0, 24.0))}  # fmt: skip
    return with_speed(results, timelines), timelines


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


def test_a_chart_has_a_point_for_each_method_with_its_name(studio):
    rows = rows_of_methods({"studio": studio[0], "empty": {"agnostic": {}}})
    assert [row["method"] for row in rows] == [*FINAL]
    assert [row["bound"] for row in rows] == [True, True, False, False, False, False]
    picture = drawn(chart(SPEED_ACCURACY, rows))
    assert picture.startswith("<svg")
    assert all(f">{method}<" in picture for method in FINAL)
    assert drawn(chart(SPEED_ACCURACY, rows)) == picture
    assert drawn_png(chart(SPEED_ACCURACY, rows)).startswith(b"\x89PNG")


def test_labels_of_points_that_meet_stand_below_each_other():
    near = {"oracle": result(90, 28.0), "agnostic": result(95, 27.99), "lean": result(10, 28.0),
            "paper": result(95, 24.0)}  # fmt: skip
    moved = {row["method"]: row["label_dy"] for row in rows_of_methods({"studio": near})}
    assert moved["oracle"] == moved["lean"] == moved["paper"] == 0
    assert 10 <= moved["agnostic"] <= 14


def test_many_methods_are_named_by_a_legend_instead(studio):
    many = {f"n{i}": result(50 + i, 20 + i) for i in (3, 7, 9, 13)}
    picture = drawn(chart(SPEED_ACCURACY, rows_of_methods({"studio": studio[0] | many})))
    assert all(picture.count(f">{method}<") == 1 for method in ("lean", "n13", "ceiling"))
    assert "role-legend" in picture
    assert "role-legend" not in drawn(chart(SPEED_ACCURACY, rows_of_methods({"studio": studio[0]})))


def test_a_curve_has_a_row_for_each_snapshot_and_quality(studio):
    rows = rows_over_time({"studio": studio[1]})
    assert len(rows) == 2 * 3 * 2
    novel = [row for row in rows if row["measure"] == "novel views"]
    assert {row["paper_db"] for row in novel} == {25.0}
    picture = drawn(chart(OVER_TIME, rows))
    assert ">novel views<" in picture
    assert ">validation frames<" in picture
    assert ">paper<" in picture
    assert ">released<" not in picture  # a legend of who is there
    untrue = {"mine": {"lean": timeline((20.0, 22.0))}}
    for point in untrue["mine"]["lean"]["points"]:
        point["image"] = None
    (measure,) = {row["measure"] for row in rows_over_time(untrue)}
    assert measure == "validation frames"


def test_dvc_draws_the_charts(studio, tmp_path):
    def dvc(*words):
        command = [sys.executable, "-m", "dvc", *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)

    dvc("init", "--no-scm", "-q")
    rows = {SPEED_ACCURACY: rows_of_methods({"studio": studio[0]}),
            OVER_TIME: rows_over_time({"studio": studio[1]})}  # fmt: skip
    for template, found in rows.items():
        name = template.replace(".vl.json", ".json")
        (tmp_path / name).write_text(json.dumps(found))
        template_file = ROOT / "deblur_avatar/reporting" / template
        shown = dvc(
            "plots", "show", name, "-t", str(template_file), "-x", "training_s", "-y", "psnr_db",
            "--show-vega",
        )  # fmt: skip
        specification = json.loads(shown.stdout)
        assert len(specification["data"]["values"]) == len(found)
        assert ">lean<" in drawn(specification)
