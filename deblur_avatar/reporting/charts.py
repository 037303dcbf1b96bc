"""Charts of methods: speed against accuracy, quality over training time; SVG and PNG.

Equal rows give equal bytes: no dates, fixed ids, the font that matplotlib brings.
"""

import io
import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox

from deblur_avatar.evaluation.metrics import HEADLINE, metric
from deblur_avatar.reporting.results_table import method_order
from deblur_avatar.reporting.speed_accuracy import QUALITIES, Row

INK, MUTED, GRID = "#1d2430", "#5f6b7a", "#e6e9ee"
COLORS = {
    "ceiling": "#9aa3af", "oracle": "#5f6b7a", "agnostic": "#c2552d", "predeblur": "#d08a2e",
    "no_fusion": "#4f9ab8", "no_nonrigid": "#3fa7a0", "n3": "#9cc3e6", "paper": "#2b6cb0",
    "n7": "#6ea6da", "n9": "#5590cb", "n13": "#1d4f86", "cubic": "#6a5acd", "learned": "#a06cc0",
    "released": "#8a5fb0", "lean": "#1f8a5b", "pair": "#4f9ab8", "mad": "#b5487a",
    "clip": "#1f8a5b", "oracle_clip": "#3d4550", "deblurred": "#d08a2e",
}  # fmt: skip
OTHER_COLORS = ("#b5487a", "#7a6a4f", "#3d7f3a", "#b08a00", "#00798c")  # methods without their own
PANEL, LEGEND = (4.6, 3.4), 1.5  # inches: width and height, width
DPI = 144
MAX_LABELS = 8  # methods; more are named by a legend instead of beside their points
# Where a label may stand, as seen from its point: shift in points, and its own alignment. Earlier
# places are preferred.
PLACES = tuple(
    (dx, dy, side, "center")
    for dy in sorted(range(-60, 61, 12), key=abs)
    for dx, side in ((11, "left"), (-11, "right"))
)
STYLE: dict[Any, Any] = {
    "font.family": ["DejaVu Sans", "sans-serif"], "font.size": 10, "text.color": INK,
    "axes.labelcolor": MUTED, "axes.edgecolor": GRID, "axes.grid": True, "axes.axisbelow": True, 
    "grid.color": GRID, "axes.spines.top": False, "axes.spines.right": False, "xtick.color": MUTED,
    "ytick.color": MUTED, "xtick.major.size": 0, "ytick.major.size": 0, "xtick.minor.size": 0,
    "axes.titlesize": 11, "axes.titleweight": "bold", "axes.titlelocation": "left",
    "svg.fonttype": "none", "svg.hashsalt": "deblur_avatar",
}  # fmt: skip


def chart_files(name: str, rows: Sequence[Row]) -> dict[str, bytes]:
    """What is written of one chart, by file name: its rows and, if there are any, its pictures.

    Args:
        name: `speed_accuracy` or `quality_over_time`.
        rows: of `rows_of_methods` or `rows_over_time`.
    """
    files = {f"{name}.json": (json.dumps(rows, indent=1) + "\n").encode()}
    return files | (drawn(name, lambda: CHARTS[name](rows)) if rows else {})


def drawn(name: str, draw: Callable[[], Figure]) -> dict[str, bytes]:
    """The pictures of a chart, `<name>.svg` and `<name>.png`, drawn in the style of all charts."""
    with matplotlib.rc_context(STYLE):
        figure = draw()
        return {f"{name}.{kind}": _saved(figure, kind) for kind in ("svg", "png")}


def speed_accuracy_chart(rows: Sequence[Row]) -> Figure:
    """Seconds of training against quality, a panel a scene.

    Ringed and joined by steps: the Pareto front. Hollow: bounds. Bars: a standard deviation either
    way.
    """
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    colors = _colors(rows)
    figure, axes = panels(1, len(scenes), named=len(colors) > MAX_LABELS)
    for panel, scene in zip(axes[0], scenes, strict=True):
        here = [row for row in rows if row["scene"] == scene]
        front = sorted((r["training_s"], r["psnr_db"]) for r in here if r["pareto"])
        panel.step(*zip(*front, strict=True), where="post", color=MUTED, lw=1.2, ls=(0, (4, 3)),
                   zorder=1) if front else None  # fmt: skip
        for row in here:
            _point(panel, row, colors[row["method"]])
        panel.set(title=scene, xlabel="training, seconds", ylabel=_quality_label())
        panel.margins(0.12)
        panel.set_xlim(left=0)
    if len(colors) > MAX_LABELS:
        legend(figure, colors)
    lay_out(figure)
    if len(colors) <= MAX_LABELS:
        _label_points(figure, axes[0], [[r for r in rows if r["scene"] == s] for s in scenes])
    return figure


def quality_over_time_chart(rows: Sequence[Row]) -> Figure:
    """Quality of snapshots over seconds of training, logarithmic: a column a scene.

    Dashed: bounds. Dotted: where `paper` ends.
    """
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    measures = [m for m in QUALITIES if any(row["measure"] == m for row in rows)]
    colors = _colors(rows)
    figure, axes = panels(len(measures), len(scenes), named=True)
    for line, measure in zip(axes, measures, strict=True):
        for panel, scene in zip(line, scenes, strict=True):
            here = [r for r in rows if (r["measure"], r["scene"]) == (measure, scene)]
            for method in method_order({row["method"] for row in here}):
                points = [row for row in here if row["method"] == method]
                panel.plot(
                    [row["training_s"] for row in points], [row["psnr_db"] for row in points],
                    color=colors[method], marker="o", ms=4.5, lw=1.8,
                    ls=(0, (4, 2.5)) if points[0]["bound"] else "-",
                )  # fmt: skip
            for goal in sorted({row["paper_db"] for row in here} - {None}):
                panel.axhline(goal, color=COLORS["paper"], alpha=0.6, lw=1.2, ls=(0, (1.5, 2.5)))
            panel.set(title=f"{scene}: {measure}", xlabel="training, seconds",
                      ylabel=_quality_label(), xscale="log")  # fmt: skip
            panel.xaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
            panel.xaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
            panel.xaxis.set_minor_locator(ticker.NullLocator())
    legend(figure, colors)
    lay_out(figure)
    return figure


CHARTS: dict[str, Callable[[Sequence[Row]], Figure]] = {
    "speed_accuracy": speed_accuracy_chart,
    "quality_over_time": quality_over_time_chart,
}


def panels(rows: int, columns: int, *, named: bool) -> tuple[Figure, list[list[Axes]]]:
    """A figure of so many panels, with room for a legend beside them if they are `named`."""
    size = columns * PANEL[0] + (LEGEND if named else 0), rows * PANEL[1]
    figure = Figure(figsize=size, dpi=DPI, layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12))
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False).tolist()


def lay_out(figure: Figure) -> None:
    """Settle once where everything lies: it takes longer than to draw it."""
    figure.draw_without_rendering()
    figure.set_layout_engine("none")


def _point(panel: Axes, row: Row, color: str) -> None:
    x, y = row["training_s"], row["psnr_db"]
    if row["psnr_low_db"] is not None:
        panel.vlines(x, row["psnr_low_db"], row["psnr_high_db"], color="#9aa3af", lw=1.5, zorder=2)
    if row["pareto"]:
        panel.plot(x, y, "o", ms=14, mfc="none", mec=INK, mew=1.2, zorder=3)
    inside, rim = ("white", color) if row["bound"] else (color, "white")
    panel.plot(x, y, "o", ms=8.5, mfc=inside, mec=rim, mew=1.8 if row["bound"] else 0.8, zorder=4)


def _label_points(figure: Figure, panels: Sequence[Axes], rows: Sequence[Sequence[Row]]) -> None:
    """Write each method beside its point, where it covers no other point and no other label."""
    for panel, here in zip(panels, rows, strict=True):
        centres = panel.transData.transform([(r["training_s"], r["psnr_db"]) for r in here])
        taken = [Bbox([centre - 12, centre + 12]) for centre in centres]
        for row, own in zip(here, list(taken), strict=True):
            others = [box for box in taken if box is not own]
            labels = [_label(panel, row, place) for place in PLACES]
            boxes = [label.get_window_extent() for label in labels]
            best = min(range(len(PLACES)), key=lambda i: (_covered(boxes[i], others, panel), i))
            taken.append(boxes[best])
            for index, label in enumerate(labels):
                if index != best:
                    label.remove()


def _label(panel: Axes, row: Row, place: tuple[int, int, str, str]) -> Annotation:
    dx, dy, side, upright = place
    return panel.annotate(
        row["method"], (row["training_s"], row["psnr_db"]), (dx, dy), textcoords="offset points",
        ha=side, va=upright, fontsize=9.5, annotation_clip=False,
    )  # fmt: skip


def _covered(box: Bbox, others: Sequence[Bbox], panel: Axes) -> float:
    """Pixels of a label that lie on something else or outside of its panel."""
    overlaps = [Bbox.intersection(box, other) for other in others]
    inside = Bbox.intersection(box, panel.bbox)
    outside = _area(box) - (_area(inside) if inside else 0)
    return round(sum(_area(overlap) for overlap in overlaps if overlap) + outside, 3)


def _area(box: Bbox) -> float:
    return float(box.width * box.height)


def legend(figure: Figure, colors: Mapping[str, str]) -> None:
    """Name each colour, beside all panels."""
    marks = [Line2D([], [], color=color, marker="o", ls="", ms=8) for color in colors.values()]
    figure.legend(marks, list(colors), loc="outside right upper", frameon=False, handletextpad=0.2)


def _colors(rows: Sequence[Row]) -> dict[str, str]:
    """A colour for each method that is there: those with one of their own first, by their order."""
    methods = {row["method"] for row in rows}
    others = enumerate(sorted(methods - COLORS.keys()))
    known = {method: color for method, color in COLORS.items() if method in methods}
    return known | {method: OTHER_COLORS[i % len(OTHER_COLORS)] for i, method in others}


def _quality_label() -> str:
    row = metric(HEADLINE)
    return f"{row.title}, {row.unit}"


def _saved(figure: Figure, kind: str) -> bytes:
    content = io.BytesIO()
    # Nothing about when and by what it was made.
    told = ("Date", "Creator", "Format", "Type") if kind == "svg" else ("Software",)
    clear = kind == "svg"  # a page has its own background
    figure.savefig(content, format=kind, metadata=dict.fromkeys(told), transparent=clear)
    data = content.getvalue()
    return data[data.index(b"<svg") :] if kind == "svg" else data
