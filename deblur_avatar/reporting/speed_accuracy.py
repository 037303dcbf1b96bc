"""Speed against accuracy: the Pareto front, time to quality, and the rows of the two charts.

Conventions. Seconds are of training, the warm-up counted in full. A method is on the Pareto front
of a scene if no other reaches as much in as little time; bounds (`ceiling`, `oracle`) saw what a
method never sees and take no part. Rows are flat dictionaries: `dvc plots show` reads them, too.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from deblur_avatar.evaluation.metrics import HEADLINE
from deblur_avatar.reporting.results_table import BOUNDS, look_up, method_order

MEASURE = "paper"  # the method whose final quality the others are timed to
QUALITY = ("image", HEADLINE)
# What a curve is of: its heading, and where a snapshot has the number.
QUALITIES = {"novel views": QUALITY, "validation frames": ("validation_psnr",)}

Results = Mapping[str, Mapping[str, Any]]  # by method
Row = dict[str, Any]


def with_speed(results: Results, learning_curves: Results) -> dict[str, dict[str, Any]]:
    """Add `speed` to the results of one scene.

    `disk_mb` is the avatar's size as stored, `time_to_paper_s` when in training a method was as
    good as `paper` is in the end (None: never), `pareto` whether it is on the front. The former two
    are None without a learning curve.
    """
    front = pareto_front(
        {
            method: (seconds, psnr)
            for method, result in results.items()
            if method not in BOUNDS
            and (seconds := look_up(result, ("cost", "train_s"))) is not None
            and (psnr := look_up(result, QUALITY)) is not None
        }
    )
    curves = {method: _curve(learning_curves.get(method, {}), "novel views") for method in results}
    goal = curves.get(MEASURE)
    return {
        method: {
            **result,
            "speed": {
                "disk_mb": look_up(learning_curves.get(method, {}), ("disk_mb",)),
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
    scenes: Mapping[str, Results], deviations: Mapping[str, Results] | None = None
) -> list[Row]:
    """One row for each scene and method of which time and quality are known.

    Args:
        scenes: results by scene and method.
        deviations: standard deviations of the results that are means, by scene and method.
    """
    rows = []
    for scene, results in scenes.items():
        scatter = (deviations or {}).get(scene, {})
        for method in method_order(results):
            result = results[method]
            seconds = look_up(result, ("cost", "train_s"))
            psnr = look_up(result, QUALITY)
            if seconds is not None and psnr is not None:
                speed = result.get("speed") or {}
                std = look_up(scatter.get(method, {}), QUALITY)
                rows.append(
                    {
                        "scene": scene,
                        "method": method,
                        "training_s": round(seconds, 1),
                        "psnr_db": round(psnr, 3),
                        "psnr_low_db": None if std is None else round(psnr - std, 3),
                        "psnr_high_db": None if std is None else round(psnr + std, 3),
                        "render_fps": _rounded(look_up(result, ("cost", "render_fps")), 1),
                        "memory_mb": _rounded(look_up(result, ("cost", "peak_memory_mb")), 0),
                        "disk_mb": _rounded(look_up(speed, ("disk_mb",)), 3),
                        "time_to_paper_s": _rounded(look_up(speed, ("time_to_paper_s",)), 1),
                        "bound": method in BOUNDS,
                        "pareto": bool(speed.get("pareto")),
                    }
                )
    return rows


def rows_over_time(learning_curves: Mapping[str, Results]) -> list[Row]:
    """One row for each snapshot of each scene and method, for each quality that was measured."""
    rows = []
    for measure in QUALITIES:
        for scene, methods in learning_curves.items():
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


def _curve(points: Mapping[str, Any], measure: str) -> list[tuple[float, float]]:
    """Seconds and quality of each snapshot at which the quality was measured."""
    return [
        (float(point["seconds"]), quality)
        for point in points.get("points") or ()
        if (quality := _quality(point, measure)) is not None
    ]


def _quality(point: Mapping[str, Any], measure: str) -> float | None:
    return look_up(point, QUALITIES[measure])


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
