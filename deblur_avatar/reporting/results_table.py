"""Results tables: rows of methods, columns of numbers, the best of each column marked.

Conventions. Results are contents of metrics files with recovery filled in
(`evaluation.recovery`). Rows come in the order of the argument: bounds, floor, then methods. Bounds
(`ceiling`, `oracle`) saw what a method never sees and take no part in the ranking.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from deblur_avatar.evaluation.metrics import HEADLINE, metric, recovered_metrics, shown_metrics

START = "initial"  # the poses before any fitting
METHODS = (START, "ceiling", "oracle", "agnostic", "predeblur", "paper", "released", "lean")
BOUNDS = ("ceiling", "oracle")
NOT_MEASURED = "not measured"


@dataclass(frozen=True)
class Column:
    """One number of a result: where it stands, how it is shown, and which way is better."""

    path: tuple[str, ...]
    label: str
    unit: str = ""
    digits: int = 2
    better: int = 0  # 1: larger, -1: smaller, 0: neither
    factor: float = 1.0  # from the unit of the file to the one shown
    kind: str = ""  # how the page shows it: a CSS class


@dataclass(frozen=True)
class Cell:
    """A number as it is shown; rank 1 is the best of its column, 2 the second best."""

    text: str
    rank: int | None = None
    kind: str = ""  # how the page shows it: a CSS class


@dataclass(frozen=True)
class Table:
    """Cells by row, with what stands above and below them.

    `bounds` are the rows that take no part in the ranking.
    """

    columns: tuple[Column, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]
    bounds: tuple[str, ...] = ()
    of: str = ""  # what a row is
    title: str = ""
    note: str = ""


def image_columns(group: str, names: Sequence[str]) -> tuple[Column, ...]:
    """Columns of some metrics, of the pictures that a group of a result is about."""
    rows = [metric(name) for name in names]
    return tuple(Column((group, r.name), r.title, r.unit, r.decimals, r.better) for r in rows)


def recovery_columns() -> tuple[Column, ...]:
    """Recovery of the metrics in decibels; that of the others is in `summary.json`."""
    rows = [row for row in recovered_metrics() if row.unit == "dB"]
    return tuple(Column(("recovery", r.name), "recovery", f"of {r.title}", 2, 1) for r in rows)


TO_CEILING = Column(("gap_to_ceiling_db",), "to ceiling", "dB", 2, -1)
TRAINING = Column(("cost", "train_s"), "training", "s", 0, -1)
TO_PAPER = Column(("speed", "time_to_paper_s"), "until as good as paper", "s", 0, -1)
RENDERING = Column(("cost", "render_fps"), "rendering", "FPS", 0, 1)
MEMORY = Column(("cost", "peak_memory_mb"), "memory", "MB", 0, -1)
GAUSSIANS = Column(("model", "gaussians"), "Gaussians", "", 0)
SIZE = Column(("model", "megabytes"), "size", "MB", 1, -1)
ON_DISK = Column(("speed", "disk_mb"), "on disk", "MB", 2, -1)
HELD_OUT_BLUR = Column(("reblur", "psnr"), "held-out blurred frames", "dB", 2, 1)
WITHOUT_TRUTH = (HELD_OUT_BLUR, TRAINING, RENDERING, GAUSSIANS)


def method_order(methods: Iterable[str]) -> list[str]:
    """Bounds, floor and named methods first, others after them by name."""
    known = {method: place for place, method in enumerate(METHODS)}
    return sorted(methods, key=lambda method: (known.get(method, len(METHODS)), method))


def look_up(result: Mapping[str, Any], path: Sequence[str]) -> float | None:
    """The number at a path; None where it was not measured."""
    value: Any = result
    for key in path:
        value = value.get(key) if isinstance(value, Mapping) else None
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        return None
    return float(value)


def results_table(
    results: Mapping[str, Mapping[str, Any]],
    columns: Sequence[Column],
    *,
    missing: str = NOT_MEASURED,
    bounds: Sequence[str] = BOUNDS,
    of: str = "method",
    deviations: Mapping[str, Mapping[str, Any]] | None = None,
    title: str = "",
    note: str = "",
) -> Table:
    """Make a table of the methods of one scene, or of their means over several.

    Args:
        results: by method.
        columns: what to show.
        missing: what stands where a number is not there.
        bounds: rows that are not ranked.
        of: what a row is.
        deviations: by method, how far the numbers scatter; shown behind them.
        title: above the table.
        note: below it.
    """
    methods = method_order(results)
    contestants = [method for method in methods if method not in bounds]
    cells: dict[str, list[Cell]] = {method: [] for method in methods}
    for column in columns:
        values = {method: look_up(results[method], column.path) for method in methods}
        ranks = _ranks({m: _rounded(values[m], column) for m in contestants}, column.better)
        for method, value in values.items():
            scatter = look_up((deviations or {}).get(method, {}), column.path)
            text = shown_with_spread(value, scatter, column, missing)
            cells[method].append(Cell(text, ranks.get(method)))
    return Table(
        columns=tuple(columns),
        rows=tuple((method, tuple(cells[method])) for method in methods),
        bounds=tuple(method for method in methods if method in bounds),
        of=of,
        title=title,
        note=note,
    )


def measured(
    results: Mapping[str, Mapping[str, Any]], columns: Sequence[Column]
) -> tuple[Column, ...]:
    """The columns in which anybody has a number."""
    return tuple(
        column
        for column in columns
        if any(look_up(result, column.path) is not None for result in results.values())
    )


def short_columns(results: Mapping[str, Mapping[str, Any]]) -> tuple[Column, ...]:
    """The main table's columns: against the truth where there is one."""
    if not measured(results, image_columns("image", [HEADLINE])):
        return measured(results, WITHOUT_TRUTH)
    views = image_columns("image", shown_metrics("short"))
    rest = (TO_CEILING, TRAINING, RENDERING, GAUSSIANS)
    return measured(results, (*views, *recovery_columns()[:1], *rest))


def shown(value: float | None, column: Column, missing: str = NOT_MEASURED) -> str:
    """A number as the page prints it: thousands apart, a true minus sign."""
    if value is None:
        return missing
    text = f"{value * column.factor:,.{column.digits}f}".replace(",", "\u2009")
    # A rounded zero has no sign.
    return text.replace("-", "\u2212") if text.strip("-0.\u2009") else text.removeprefix("-")


def shown_with_spread(
    value: float | None, std: float | None, column: Column, missing: str = NOT_MEASURED
) -> str:
    """A number and how far it scatters, where both are known."""
    text = shown(value, column, missing)
    if value is None or std is None:
        return text
    return f"{text} \u00b1 {shown(std, column)}"


def markdown(table: Table) -> str:
    """The table for a page of documents: best in bold, second best in italics.

    Rows are names, set as code, where the table says what they are names of.
    """
    heads = [f"{column.label}{f' ({column.unit})' if column.unit else ''}{_arrow(column)}"
             for column in table.columns]  # fmt: skip
    lines = [[table.of, *heads], ["---", *["---:"] * len(heads)]]
    for method, cells in table.rows:
        marked = [_emphasis(cell) for cell in cells]
        lines.append([f"`{method}`" if table.of else method, *marked])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def plain(table: Table) -> str:
    """The table for a terminal: columns aligned, best marked with `*`."""
    rows = [["", *(f"{column.label} {column.unit}".strip() + "  " for column in table.columns)]]
    for method, cells in table.rows:
        rows.append([method, *(cell.text + (" *" if cell.rank == 1 else "  ") for cell in cells)])
    widths = [max(len(row[index]) for row in rows) for index in range(len(rows[0]))]
    return "\n".join(
        "  ".join(
            text.ljust(width) if place == 0 else text.rjust(width)
            for place, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    )


def _rounded(value: float | None, column: Column) -> float | None:
    """The number that is shown: what looks equal shares a place."""
    return None if value is None else round(value * column.factor, column.digits)


def _ranks(values: Mapping[str, float | None], better: int) -> dict[str, int]:
    """First and second place; equal numbers share a place, a column with one number has none."""
    known = {name: value for name, value in values.items() if value is not None}
    if better == 0 or len(known) < 2:
        return {}
    places = sorted(set(known.values()), reverse=better > 0)
    ranks = {name: places.index(value) + 1 for name, value in known.items()}
    return {name: rank for name, rank in ranks.items() if rank <= 2 and len(places) > 1}


def _arrow(column: Column) -> str:
    return {1: " ↑", -1: " ↓", 0: ""}[column.better]


def _emphasis(cell: Cell) -> str:
    if cell.rank == 1:
        return f"**{cell.text}**"
    return f"*{cell.text}*" if cell.rank == 2 else cell.text
