"""Speed against accuracy as a chart: a Vega-Lite specification, drawn without a network."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import vl_convert

from deblur_avatar.pipeline.results_table import BOUNDS, look_up, method_order

SCHEMA = "https://vega.github.io/schema/vega-lite/v5.json"
VERSION = "5.20"  # of Vega-Lite, as vl-convert names it
WIDTH, HEIGHT = 360, 240  # pixels of one scene's panel
INK, MUTED, GRID = "#1d2430", "#5f6b7a", "#e6e9ee"
COLORS = {
    "ceiling": "#9aa3af", "oracle": "#5f6b7a", "blind": "#c2552d", "paper": "#2b6cb0",
    "released": "#8a5fb0", "lean": "#1f8a5b",
}  # fmt: skip
OTHER = "#b58900"


def speed_accuracy(scenes: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> dict[str, Any]:
    """One panel a scene: seconds of training against PSNR of novel views, one point a method.

    Args:
        scenes: results by scene and method; those without both numbers are left out.

    Returns:
        A Vega-Lite specification with its data inside. Bounds are hollow.
    """
    panels = [_panel(scene, _points(results)) for scene, results in scenes.items()]
    return {
        "$schema": SCHEMA,
        "description": "Seconds of training against PSNR of novel views, by method.",
        "hconcat": [panel for panel in panels if panel["data"]["values"]],
        "spacing": 48,
        "background": None,
        "config": {
            "font": "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif",
            "view": {"stroke": None},
            "axis": {
                "labelColor": MUTED, "titleColor": MUTED, "gridColor": GRID, "tickColor": GRID,
                "domainColor": GRID, "gridOpacity": 0.6, "labelFontSize": 12, "titleFontSize": 12,
                "titleFontWeight": "normal", "titlePadding": 10,
            },
            "title": {"color": INK, "fontSize": 14, "anchor": "start", "offset": 12},
        },
    }  # fmt: skip


def drawn(specification: Mapping[str, Any]) -> str:
    """The chart as SVG, the same bytes each time."""
    return vl_convert.vegalite_to_svg(dict(specification), vl_version=VERSION)


def _points(results: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    points = []
    for method in method_order(results):
        seconds = look_up(results[method], ("cost", "train_s"))
        psnr = look_up(results[method], ("image", "psnr"))
        if seconds is not None and psnr is not None:
            points.append(
                {
                    "method": method,
                    "training_s": round(seconds, 1),
                    "psnr_db": round(psnr, 3),
                    "bound": method in BOUNDS,
                    "color": COLORS.get(method, OTHER),
                }
            )
    return points


def _panel(scene: str, points: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    heights = [point["psnr_db"] for point in points] or [0.0]
    color = {"field": "color", "type": "nominal", "scale": None, "legend": None}
    place = {
        "x": {
            "field": "training_s", "type": "quantitative", "title": "training, seconds",
            "scale": {"zero": True, "nice": True}, "axis": {"tickCount": 5},
        },
        "y": {
            "field": "psnr_db", "type": "quantitative", "title": "PSNR of novel views, dB",
            "scale": {"domain": [math.floor(min(heights) - 0.5), math.ceil(max(heights) + 0.5)]},
            "axis": {"tickCount": 6},
        },
    }  # fmt: skip
    hollow = {"condition": {"test": "datum.bound", "value": "white"}, **color}
    return {
        "title": scene,
        "width": WIDTH,
        "height": HEIGHT,
        "data": {"values": list(points)},
        "encoding": place,
        "layer": [
            {
                "mark": {"type": "point", "size": 110, "strokeWidth": 2, "opacity": 1},
                "encoding": {"stroke": color, "fill": hollow},
            },
            {
                "mark": {"type": "text", "align": "left", "dx": 11, "fontSize": 12},
                "encoding": {"text": {"field": "method"}, "color": {"value": INK}},
            },
        ],
    }
