"""Speed against accuracy: rows of numbers and the charts that are drawn of them without a network.

Conventions. Seconds are of training, the warm-up counted in full. Templates are Vega-Lite with
DVC's mark where the rows go, so that `dvc plots show` draws the same charts. A method is on the
Pareto front of a scene if no other reaches as much in as little time; bounds (`ceiling`, `oracle`)
saw what a method never sees and take no part.
"""

import json
import math
from collections.abc import Mapping, Sequence, Set
from itertools import pairwise
from pathlib import Path
from typing import Any

import vl_convert

from deblur_avatar.reporting.results_table import (
    BOUNDS,
    look_up,
    method_order,
)

VERSION = "5.20"  # of Vega-Lite, as vl-convert names it
SPEED_ACCURACY, OVER_TIME = "speed_accuracy.vl.json", "quality_over_time.vl.json"
PIXELS_A_POINT = 2.0  # of PNG files
PLOT = 360, 230  # pixels of a chart's plot, roughly: where its template's padding ends
MAX_LABELS = 8
LETTER, LINE = 8, 14  # pixels of a label's letter and line
MEASURE = "paper"  # the method whose final quality the others are timed to
# What a curve is of: its heading, and where a snapshot has the number.
QUALITIES = {"novel views": ("image", "psnr"), "validation frames": ("validation_psnr",)}

Results = Mapping[str, Mapping[str, Any]]  # by method
Row = dict[str, Any]


def with_speed(results: Results, timelines: Results) -> dict[str, dict[str, Any]]:
    """Add `speed` to the results of one scene.

    `disk_mb` is the avatar's size as stored, `time_to_paper_s` when in training a method was as
    good as `paper` is in the end (None: never), `pareto` whether it is on the front. The former two
    are None without a timeline.
    """
    front = pareto_front(
        {
            method: (seconds, psnr)
            for method, result in results.items()
            if method not in BOUNDS
            and (seconds := look_up(result, ("cost", "train_s"))) is not None
            and (psnr := look_up(result, ("image", "psnr"))) is not None
        }
    )
    curves = {method: _curve(timelines.get(method, {}), "novel views") for method in results}
    goal = curves.get(MEASURE)
    return {
        method: {
            **result,
            "speed": {
                "disk_mb": look_up(timelines.get(method, {}), ("disk_mb",)),
                "time_to_paper_s": seconds_to(curves[method], goal[-1][1]) if goal else None,
                "pareto": method in front,
            },
        }
        for method, result in results.items()
    }


def pareto_front(points: Mapping[str, tuple[float, float]]) -> list[str]:
    """Who is not beaten in both, of seconds (less is better) and quality (more), in order of time.

    Equals do not beat each other.
    """
    return sorted(
        (
            name
            for name, (seconds, quality) in points.items()
            if not any(
                (s <= seconds and q >= quality) and (s, q) != (seconds, quality)
                for s, q in points.values()
            )
        ),
        key=lambda name: (*points[name], name),
    )


def seconds_to(curve: Sequence[tuple[float, float]], goal: float) -> float | None:
    """When a curve of (seconds, quality) first reaches a goal; None if it never does.

    Between two snapshots quality is taken to be straight over the logarithm of time.
    """
    if curve and curve[0][1] >= goal:
        return curve[0][0]
    for (start, low), (end, high) in pairwise(curve):
        if low < goal <= high:
            share = (goal - low) / (high - low)
            return start * math.exp(share * math.log(end / start)) if share < 1 else end
    return None


def rows_of_methods(
    scenes: Mapping[str, Results], spreads: Mapping[str, Results] | None = None
) -> list[Row]:
    """One row for each scene and method of which time and quality are known.

    Args:
        scenes: results by scene and method.
        spreads: standard deviations of the results that are means, by scene and method.
    """
    rows = []
    for scene, results in scenes.items():
        scatter = (spreads or {}).get(scene, {})
        of_scene: list[Row] = []
        for method in method_order(results):
            result = results[method]
            seconds = look_up(result, ("cost", "train_s"))
            psnr = look_up(result, ("image", "psnr"))
            if seconds is not None and psnr is not None:
                speed = result.get("speed") or {}
                spread = look_up(scatter.get(method, {}), ("image", "psnr"))
                of_scene.append(
                    {
                        "scene": scene,
                        "method": method,
                        "training_s": round(seconds, 1),
                        "psnr_db": round(psnr, 3),
                        "psnr_low_db": None if spread is None else round(psnr - spread, 3),
                        "psnr_high_db": None if spread is None else round(psnr + spread, 3),
                        "render_fps": _rounded(look_up(result, ("cost", "render_fps")), 1),
                        "memory_mb": _rounded(look_up(result, ("cost", "peak_memory_mb")), 0),
                        "disk_mb": _rounded(look_up(speed, ("disk_mb",)), 3),
                        "time_to_paper_s": _rounded(look_up(speed, ("time_to_paper_s",)), 1),
                        "bound": method in BOUNDS,
                        "pareto": bool(speed.get("pareto")),
                    }
                )
        rows += _with_labels_apart(of_scene)
    return rows


def _with_labels_apart(rows: Sequence[Row]) -> list[Row]:
    """Add `label_dy`: by how many pixels a label is moved down so that it covers no other one."""
    if not rows:
        return []
    qualities = [row["psnr_db"] for row in rows]
    high, range_db = max(qualities), max(max(qualities) - min(qualities), 1e-6)
    longest = max(row["training_s"] for row in rows) or 1.0
    taken: list[tuple[float, float, float]] = []  # left and right end, and height, of each label
    moved: dict[str, int] = {}
    for row in sorted(rows, key=lambda row: (-row["psnr_db"], row["training_s"])):
        left = PLOT[0] * row["training_s"] / longest
        right = left + LETTER * len(row["method"])
        top = down = PLOT[1] * (high - row["psnr_db"]) / range_db
        for other_left, other_right, other in sorted(taken, key=lambda label: label[2]):
            if left < other_right and other_left < right and abs(down - other) < LINE:
                down = other + LINE
        taken.append((left, right, down))
        moved[row["method"]] = round(down - top)
    return [{**row, "label_dy": moved[row["method"]]} for row in rows]


def rows_over_time(timelines: Mapping[str, Results]) -> list[Row]:
    """One row for each snapshot of each scene and method, for each quality that was measured."""
    rows = []
    for measure in QUALITIES:
        for scene, methods in timelines.items():
            curves = {method: _curve(methods[method], measure) for method in method_order(methods)}
            goal = curves.get(MEASURE)
            for method, curve in curves.items():
                points = [p for p in methods[method]["points"] if _quality(p, measure) is not None]
                for point, (seconds, psnr) in zip(points, curve, strict=True):
                    rows.append(
                        {
                            "scene": scene,
                            "measure": measure,
                            "method": method,
                            "stage": point["stage"],
                            "iteration": point["iteration"],
                            "training_s": round(seconds, 2),
                            "psnr_db": round(psnr, 3),
                            "paper_db": round(goal[-1][1], 3) if goal else None,
                            "bound": method in BOUNDS,
                        }
                    )
    return rows


def chart(template: str, rows: Sequence[Row]) -> dict[str, Any]:
    """A Vega-Lite specification of its own: one of the templates with its rows inside.

    Its legend names the methods that are there. More than `MAX_LABELS` are named by a legend
    instead of beside their points.
    """
    content = json.loads((Path(__file__).parent / template).read_text())
    methods = {str(row["method"]) for row in rows}
    _keep_colors(content, methods)
    if template == SPEED_ACCURACY and len(methods) > MAX_LABELS:
        layers = content["spec"]["layer"]
        content["spec"]["layer"] = [layer for layer in layers if layer["mark"]["type"] != "text"]
        for layer in layers:
            for channel in layer["encoding"].keys() & {"color", "stroke"}:
                layer["encoding"][channel]["legend"] = {"title": None, "orient": "right"}
    return content | {"data": {"values": list(rows)}}


def drawn(specification: Mapping[str, Any]) -> str:
    """The chart as SVG, the same bytes each time."""
    return vl_convert.vegalite_to_svg(dict(specification), vl_version=VERSION)


def drawn_png(specification: Mapping[str, Any]) -> bytes:
    """The chart as PNG on white."""
    on_white = {**specification, "background": "white"}
    return vl_convert.vegalite_to_png(on_white, vl_version=VERSION, scale=PIXELS_A_POINT)


def _keep_colors(node: Any, methods: Set[str]) -> None:
    """Take the colours of other methods out of a specification's scales."""
    if isinstance(node, dict) and node.get("field") == "method" and "scale" in node:
        scale = node["scale"]
        kept = [pair for pair in zip(scale["domain"], scale["range"], strict=True)
                if pair[0] in methods]  # fmt: skip
        scale["domain"], scale["range"] = [name for name, _ in kept], [color for _, color in kept]
    for child in node.values() if isinstance(node, dict) else node:
        if isinstance(child, dict | list):
            _keep_colors(child, methods)


def _curve(timeline: Mapping[str, Any], measure: str) -> list[tuple[float, float]]:
    """Seconds and quality of each snapshot at which the quality was measured."""
    return [
        (float(point["seconds"]), quality)
        for point in timeline.get("points") or ()
        if (quality := _quality(point, measure)) is not None
    ]


def _quality(point: Mapping[str, Any], measure: str) -> float | None:
    return look_up(point, QUALITIES[measure])


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
