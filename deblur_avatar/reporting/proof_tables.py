"""The proof's tables: a grid of avatars and motions, windows, and how far cells are from converged.

Conventions. As `evaluation.proof_grid`; a cell of a table is a number, its recovery within its
avatar, or both.
"""

from collections.abc import Mapping, Sequence

from deblur_avatar.config.proof import MOTIONS
from deblur_avatar.evaluation.metrics import metric
from deblur_avatar.evaluation.proof_grid import Entry, Found, Grid
from deblur_avatar.reporting.results_table import (
    Cell,
    Column,
    Table,
    look_up,
    shown,
    shown_with_spread,
)
from deblur_avatar.reporting.speed_accuracy import seconds_to

UNFITTED = "\u2013"  # a cell that nobody has fitted
UNKNOWN = "blur costs too little"
SHARP = ("oracle", "oracle_clip", "ceiling")
RECOVERY_DIGITS = 2
MAIN = "psnr_seen"  # the metric of curves, windows and convergence
SETTLED = 0.95  # of the final quality: when an avatar is as good as done


def columns(motions: Sequence[str]) -> tuple[Column, ...]:
    """Columns of a grid; those that saw sharp frames are set back."""
    return tuple(Column((), m, kind="other" if m in SHARP else "") for m in motions)


def grid_table(grid: Grid, name: str, title: str) -> Table:
    """One metric of every avatar and motion, and below it what is won back within the avatar."""
    row = metric(name)
    number = Column(("image", name), row.title, row.unit, row.decimals)
    share = Column(("recovery", name), "recovery", digits=RECOVERY_DIGITS)
    rows = []
    for avatar, entries in grid.items():
        best = _best(entries, number, row.better)
        rows.append((avatar, tuple(_cell(entries.get(m), number, m, m == best) for m in MOTIONS)))
        shares = tuple(_cell(entries.get(m), share, m, False) for m in MOTIONS)
        rows.append((f"{avatar}: recovery", shares))
    note = (
        f"{row.title}{f' in {row.unit}' if row.unit else ''}, "
        f"{'larger' if row.better > 0 else 'smaller'} is better; best of those that saw blur in "
        "bold. Recovery is (method \u2212 agnostic) / (oracle \u2212 agnostic) of the same avatar."
    )
    return Table(columns(MOTIONS), tuple(rows), title=title, note=note)


def windows_table(grids: Mapping[int, Grid], name: str, title: str) -> Table:
    """One metric and its recovery by blur window: a row an avatar and motion."""
    row = metric(name)
    number = Column(("image", name), row.title, row.unit, row.decimals)
    share = Column(("recovery", name), "recovery", digits=RECOVERY_DIGITS)
    heads = []
    for window in grids:
        heads += [Column((), f"{window} sub-frames", row.title), Column((), "", "recovery")]
    known = {
        (avatar, motion): None
        for grid in grids.values()
        for avatar, entries in grid.items()
        for motion in entries
    }
    common = [
        key for key in known if sum(key[1] in grid.get(key[0], {}) for grid in grids.values()) > 1
    ]
    rows = []
    for avatar, motion in common:
        cells: list[Cell] = []
        for grid in grids.values():
            entry = grid.get(avatar, {}).get(motion)
            cells += [_cell(entry, number, motion, False), _cell(entry, share, motion, False)]
        rows.append((f"{avatar}, {motion}", tuple(cells)))
    return Table(tuple(heads), tuple(rows), title=title)


def cost_table(grid: Grid, title: str) -> Table:
    """Seconds of training, Gaussians and pictures a second of every cell."""
    shown_columns = (
        Column(("cost", "train_s"), "training", "s", 0),
        Column(("cost", "render_fps"), "rendering", "FPS", 0),
        Column(("cost", "peak_memory_mb"), "memory", "MB", 0),
        Column(("model", "gaussians"), "Gaussians", "", 0),
        Column(("motion", "joint_error_mm"), "joints", "mm", 1),
        Column(("motion", "travel_error_mm"), "travel missed", "mm", 1),
        Column(("gap_to_ceiling_db",), "to ceiling", "dB", 2),
    )
    rows = tuple(
        (
            f"{avatar}, {motion}",
            tuple(
                Cell(shown_with_spread(*_measured(entry, column), column, UNFITTED))
                for column in shown_columns
            ),
        )
        for avatar, entries in grid.items()
        for motion, entry in entries.items()
    )
    return Table(shown_columns, rows, title=title)


def _cell(entry: Entry | None, column: Column, motion: str, best: bool) -> Cell:
    kind = "other" if motion in SHARP else ""
    if entry is None:
        return Cell(UNFITTED, kind=kind)
    value, scatter = _measured(entry, column)
    if value is None and column.path[0] == "recovery":
        return Cell(UNKNOWN if motion not in ("agnostic", "oracle") else UNFITTED, kind="none")
    return Cell(shown_with_spread(value, scatter, column, UNFITTED), 1 if best else None, kind)


def _measured(entry: Entry, column: Column) -> tuple[float | None, float | None]:
    return look_up(entry.mean, column.path), look_up(entry.deviation, column.path)


def _best(entries: Mapping[str, Entry], column: Column, better: int) -> str | None:
    """The motion that did best of those that saw blurred frames, if there are two."""
    values = {
        motion: value
        for motion, entry in entries.items()
        if motion not in SHARP and (value := look_up(entry.mean, column.path)) is not None
    }
    return max(values, key=lambda m: better * values[m]) if len(values) > 1 else None


def shown_seconds(value: float | None) -> str:
    """A number of seconds as tables have it."""
    return shown(value, Column((), "", "s", 0), UNFITTED)


def curve_of(one: Found) -> list[tuple[float, float]]:
    """Seconds and `MAIN` of a cell's snapshots."""
    points = (one.curve or {}).get("points") or ()
    return [
        (float(point["seconds"]), quality)
        for point in points
        if (quality := look_up(point, ("image", MAIN))) is not None
    ]


def settled_s(curve: Sequence[tuple[float, float]]) -> float | None:
    """Seconds until `SETTLED` of the final quality; None without a curve."""
    return seconds_to(curve, SETTLED * curve[-1][1]) if curve else None


def convergence_table(found: Sequence[Found], scene: str) -> Table:
    """What each doubling of the iterations brought, the last half of each fit, and 95 % of it."""
    row = metric(MAIN)
    number, gain = Column((), row.title, "dB", 2), Column((), "", "dB", 2)
    lengths = {one.result["run"]["iterations"]: one.cell.schedule for one in found}
    cells = dict.fromkeys((one.cell.avatar, one.cell.motion) for one in found)
    heads = [Column((), f"{length:,} it.", "dB") for length in sorted(lengths)]
    heads += [Column((), "last doubling", "dB"), Column((), "second half of the longest", "dB")]
    heads += [Column((), "until 95 %", "s"), Column((), "of", "s")]
    rows = []
    for avatar, motion in cells:
        ends: dict[int, Found] = {}
        for one in found:
            if (one.cell.avatar, one.cell.motion) == (avatar, motion):
                ends.setdefault(one.result["run"]["iterations"], one)
        values = {length: look_up(one.result, ("image", MAIN)) for length, one in ends.items()}
        texts = [shown(values.get(length), number, UNFITTED) for length in sorted(lengths)]
        longest = ends[max(ends)]
        curve = curve_of(longest)
        texts.append(shown(_last_doubling(values), gain, UNFITTED))
        texts.append(shown(_second_half(longest), gain, UNFITTED))
        texts += [shown_seconds(settled_s(curve)), shown_seconds(curve[-1][0] if curve else None)]
        rows.append((f"{avatar}, {motion}", tuple(map(Cell, texts))))
    note = (
        "Converged is what gains under 0.1 dB when its iterations are doubled. The second half of "
        "one fit is no such doubling, since rates fall along it; it is there for every cell."
    )
    return Table(tuple(heads), tuple(rows), title=f"{scene}: {row.title} by iterations", note=note)


def _last_doubling(values: Mapping[int, float | None]) -> float | None:
    """What the longest fit is better by than the one of half its iterations."""
    last = max(values)
    longest, half = values[last], values.get(last // 2)
    return None if longest is None or half is None else longest - half


def _second_half(one: Found) -> float | None:
    """What the second half of a fit's iterations brought, by its snapshots."""
    points = (one.curve or {}).get("points") or ()
    values = {point["iteration"]: look_up(point, ("image", MAIN)) for point in points}
    return _last_doubling(values) if values else None
