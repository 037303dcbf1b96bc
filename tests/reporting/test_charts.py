import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from deblur_avatar.reporting.charts import COLORS, chart_files, speed_accuracy_chart

TEMPLATE = Path(__file__).resolve().parents[2] / "deblur_avatar/reporting/dvc_plot.vl.json"


def point(method, seconds, psnr, scene="studio", **changes):
    return {
        "scene": scene, "method": method, "training_s": seconds, "psnr_db": psnr,
        "psnr_low_db": None, "psnr_high_db": None, "bound": method in ("ceiling", "oracle"),
        "pareto": False,
    } | changes  # fmt: skip


def snapshot(method, seconds, psnr, measure="novel views", **changes):
    return {
        "scene": "studio", "measure": measure, "method": method, "stage": "fusion",
        "iteration": 10, "training_s": seconds, "psnr_db": psnr, "paper_db": 25.0,
        "bound": method == "oracle",
    } | changes  # fmt: skip


def texts(files, name="speed_accuracy"):
    return re.findall(r"<text[^>]*>([^<]*)</text>", files[f"{name}.svg"].decode())


FEW = [point("oracle", 90, 28.0), point("paper", 200, 25.0), point("lean", 100, 27.0, pareto=True)]


def test_every_method_stands_beside_its_point_once():
    files = chart_files("speed_accuracy", FEW)
    assert {"studio", "training, seconds", "PSNR, dB"} <= set(texts(files))
    assert [texts(files).count(row["method"]) for row in FEW] == [1, 1, 1]
    assert files["speed_accuracy.png"].startswith(b"\x89PNG")


def test_equal_rows_give_equal_bytes_without_a_date():
    files = chart_files("speed_accuracy", FEW)
    assert files == chart_files("speed_accuracy", FEW)
    assert b"date" not in files["speed_accuracy.svg"]
    assert b"Software" not in files["speed_accuracy.png"]


def test_without_rows_there_is_no_picture():
    assert chart_files("speed_accuracy", []) == {"speed_accuracy.json": b"[]\n"}


@pytest.mark.parametrize("near", [0.0, 0.02, 0.1])
def test_labels_of_points_that_meet_do_not_cover_each_other(near):
    rows = [point(f"method {i}", 90 + 20 * near * i, 28 - near * i) for i in range(6)]
    figure = speed_accuracy_chart([*rows, point("lean", 10, 24.0)])
    boxes = [label.get_window_extent() for label in figure.axes[0].texts]
    assert len(boxes) == 7
    pairs = [(a, b) for i, a in enumerate(boxes) for b in boxes[:i]]
    assert not any(a.overlaps(b) for a, b in pairs)


def test_a_label_at_the_rim_stands_inside_of_its_panel():
    (panel,) = speed_accuracy_chart([*FEW, point("predeblur", 220, 26.0)]).axes
    for label in panel.texts:
        assert label.get_window_extent().x1 <= panel.bbox.x1


def test_many_methods_are_named_by_a_legend_instead():
    rows = [point(method, 50 + i, 20 + i) for i, method in enumerate(COLORS)]
    figure = speed_accuracy_chart(rows)
    assert not figure.axes[0].texts
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.texts] == list(COLORS)


def test_methods_without_a_colour_of_their_own_are_drawn_too():
    rows = [point(f"variant {i}", 50 + i, 20 + i) for i in range(3)]
    figure = speed_accuracy_chart(rows)
    colors = {line.get_markerfacecolor() for line in figure.axes[0].lines}
    assert len(colors) == 3


def test_curves_have_a_panel_for_each_quality_and_a_legend_of_who_is_there():
    rows = [snapshot(m, s, 20 + s, q) for m in ("oracle", "paper") for s in (1, 5)
            for q in ("novel views", "validation frames")]  # fmt: skip
    shown = texts(chart_files("quality_over_time", rows), "quality_over_time")
    assert {"studio: novel views", "studio: validation frames", "oracle", "paper"} <= set(shown)
    assert "lean" not in shown


def test_dvc_reads_the_rows_and_tells_methods_apart(tmp_path):
    def dvc(*words):
        command = [sys.executable, "-m", "dvc", *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)

    dvc("init", "--no-scm", "-q")
    (tmp_path / "speed_accuracy.json").write_bytes(
        chart_files("speed_accuracy", FEW)["speed_accuracy.json"]
    )
    shown = dvc(
        "plots", "show", "speed_accuracy.json", "-t", str(TEMPLATE), "-x", "training_s",
        "-y", "psnr_db", "--show-vega",
    )  # fmt: skip
    specification = json.loads(shown.stdout)
    assert len(specification["data"]["values"]) == len(FEW)
    assert specification["spec"]["encoding"]["y"]["field"] == "psnr_db"
    assert specification["spec"]["encoding"]["color"]["field"] == "method"
