"""The paper's ablations in the form of its tables: means and standard deviations over seeds.

Conventions. A standard deviation is over seeds (n - 1). Recovery is taken within each
seed, against that seed's own `agnostic` and `oracle`. What the paper measured stands beside, from
another data set (ZJU-MoCap with synthetic blur): only which row is better can be compared.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deblur_avatar.config.runs import RunParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.recovery import (
    Result,
    averaged,
    compared,
    standard_deviations,
)
from deblur_avatar.files import write_bytes, write_json
from deblur_avatar.pipeline.report import read_learning_curves, read_results
from deblur_avatar.reporting.charts import chart_files
from deblur_avatar.reporting.page import render_page
from deblur_avatar.reporting.results_table import (
    GAUSSIANS,
    MEMORY,
    NOT_MEASURED,
    ON_DISK,
    RENDERING,
    SIZE,
    TO_PAPER,
    TRAINING,
    Cell,
    Column,
    Table,
    image_columns,
    look_up,
    markdown,
    recovery_columns,
    shown_with_spread,
)
from deblur_avatar.reporting.speed_accuracy import (
    MEASURE,
    rows_of_methods,
    rows_over_time,
    with_speed,
)

TEMPLATE = Path(__file__).parent / "ablations.html.jinja"
NEVER = "never"  # as good as `paper` is in the end
IMAGE = ("psnr", "ssim_range2", "ssim", "lpips_vgg", "flip", "psnr_seen")  # in the paper's order
PAPER = tuple(Column((), f"paper*: {metric}", kind="other") for metric in ("PSNR", "SSIM", "LPIPS"))

# arXiv 2501.13335: means over six scenes (ablations), scene 377 (number of virtual poses); PSNR dB,
# SSIM, LPIPS x 1000.
ABLATIONS = {
    "no_nonrigid": ("29.43", "0.9659", "38.12"),
    "agnostic": ("30.05", "0.9668", "37.95"),
    "no_fusion": ("29.83", "0.9676", "36.42"),
    "paper": ("30.24", "0.9684", "35.82"),
}
NUMBERS = {
    "n3": ("30.03", "", "27.20"),
    "paper": ("30.36", "0.9765", "26.69"),
    "n7": ("30.27", "", "26.91"),
    "n9": ("30.20", "", "27.31"),
    "n13": ("30.18", "", "27.12"),
}


@dataclass(frozen=True)
class Section:
    """One table: its rows by method, what a row is called, and what the paper has there."""

    title: str
    note: str
    rows: Mapping[str, str]
    paper: Mapping[str, tuple[str, str, str]]


SECTIONS = (
    Section(
        "Main ablation",
        "Without motion modelling is the recipe for sharp frames on blurred ones.",
        {
            "no_nonrigid": "without non-rigid deformation",
            "agnostic": "without motion modelling",
            "no_fusion": "without fusion",
            "paper": "full",
        },
        ABLATIONS,
    ),
    Section(
        "Number of virtual poses",
        "The paper's numbers are of its scene 377.",
        {"n3": "n = 3", "paper": "n = 5", "n7": "n = 7", "n9": "n = 9", "n13": "n = 13"},
        NUMBERS,
    ),
    Section(
        "Trajectory representation",
        "Between the ends of an exposure: straight, four knots, or as a network has learned.",
        {"paper": "slerp", "cubic": "cubic B-spline", "learned": "learned"},
        {},
    ),
    Section(
        "Methods and bounds",
        "Ceiling and oracle saw sharp frames.",
        {
            "ceiling": "ceiling",
            "oracle": "oracle",
            "agnostic": "agnostic",
            "predeblur": "deblurred in the picture, then agnostic",
            "paper": "paper, text",
            "released": "paper, released code",
            "lean": "lean",
        },
        {},
    ),
)


@dataclass(frozen=True)
class AblationReport:
    """A page, its tables for reading in a repository, and the numbers behind them."""

    page: str
    tables: str
    summary: dict[str, Any]
    charts: dict[str, bytes]  # files by name

    def save(self, folder: Path) -> None:
        """Write `index.html`, `tables.md`, `summary.json` and the charts as `Report.save` does.

        Raises:
            ArtifactError: if the disk refuses.
        """
        files = {"index.html": self.page.encode(), "tables.md": self.tables.encode()}
        for file, content in (files | self.charts).items():
            write_bytes(folder / file, content)
        write_json(folder / "summary.json", self.summary)


@dataclass(frozen=True)
class _Seeds:
    """What all seeds measured of one scene, by method."""

    count: int
    results: Mapping[str, Sequence[Result]]  # one a seed
    means: Mapping[str, Result]
    deviations: Mapping[str, Result]
    curves: Mapping[str, Result]  # means


def report_ablations(
    folders: Sequence[Path], runs: Mapping[str, RunParams], scene: str, schedule: str
) -> AblationReport:
    """Gather what these runs left in `metrics` below each seed's folder.

    Raises:
        ArtifactError: if no seed has results of the scene, a file is damaged, or avatars kept on
            the way are of other iterations from seed to seed.
    """
    seeds = _gathered(folders, runs, scene)
    about = (
        f"Scene {scene}, schedule {schedule}, novel views, {seeds.count} seeds: mean ± standard "
        "deviation."
    )
    tables = [table for section in SECTIONS if (table := _table(section, seeds)).rows]
    text = f"{about} Columns marked paper*: the paper's own numbers, of another data set.\n\n"
    text += "\n".join(f"### {t.title}\n\n{t.note}\n\n{markdown(t)}" for t in tables)
    rows = rows_of_methods({scene: seeds.means}, {scene: seeds.deviations})
    charts = chart_files("speed_accuracy", rows)
    charts |= chart_files("quality_over_time", rows_over_time({scene: seeds.curves}))
    pictures = {Path(f).stem: charts[f].decode() for f in charts if f.endswith(".svg")}
    quiet = (NOT_MEASURED, NEVER)
    page = render_page(TEMPLATE, about=about, tables=tables, quiet=quiet, charts=pictures)
    return AblationReport(page, text, _summary(seeds, scene, schedule), charts)


def _gathered(folders: Sequence[Path], runs: Mapping[str, RunParams], scene: str) -> _Seeds:
    every: dict[str, list[Result]] = {}
    kept: dict[str, list[Result]] = {}
    count = 0
    for folder in folders:
        results = read_results(folder / "metrics", runs).get(scene)
        if results is not None:
            count += 1
            for method, result in compared(results).items():
                every.setdefault(method, []).append(result)
            curves = read_learning_curves(folder / "metrics", runs).get(scene, {})
            for method, curve in curves.items():
                kept.setdefault(method, []).append(curve)
    if not count:
        raise ArtifactError(
            f"no results of {scene} in {', '.join(map(str, folders))}; run `dvc repro` there"
        )
    mean_curves = {method: _mean_curve(method, found) for method, found in kept.items()}
    means = {method: averaged(results) for method, results in every.items()}
    deviations = {method: standard_deviations(results) for method, results in every.items()}
    return _Seeds(count, every, with_speed(means, mean_curves), deviations, mean_curves)


def _mean_curve(method: str, curves: Sequence[Result]) -> Result:
    """Means of what was measured at the same moments of several seeds."""
    moments = [[(p["stage"], p["iteration"]) for p in t["points"]] for t in curves]
    if any(other != moments[0] for other in moments):
        raise ArtifactError(
            f"{method} was looked at after other iterations from seed to seed; run `dvc repro`"
        )
    points = zip(*(curve["points"] for curve in curves), strict=True)
    means = [{**averaged(same), "iteration": same[0]["iteration"]} for same in points]
    return {**averaged(curves), "points": means}


def _columns() -> tuple[Column, ...]:
    cost = (TRAINING, TO_PAPER, RENDERING, MEMORY, GAUSSIANS, SIZE, ON_DISK)
    return (*image_columns("image", IMAGE), recovery_columns()[0], *cost)


def _table(section: Section, seeds: _Seeds) -> Table:
    """One section; methods that nobody has run are left out.

    Nothing is ranked: most rows are apart by less than they scatter.
    """
    rows = []
    for method, label in section.rows.items():
        if method in seeds.results:
            cells = [
                Cell(shown_with_spread(mean, scatter, column, _missing(seeds, method, column)))
                for column, mean, scatter in _measured(seeds, method)
            ]
            if section.paper:
                paper = section.paper.get(method, ("",) * len(PAPER))
                cells += [Cell(text, kind="other") for text in paper]
            rows.append((label, tuple(cells)))
    columns = (*_columns(), *(PAPER if section.paper else ()))
    return Table(columns, tuple(rows), title=section.title, note=section.note)


def _measured(seeds: _Seeds, method: str) -> list[tuple[Column, float | None, float | None]]:
    """Each column's mean and standard deviation over results of one method."""
    mean, scatter = seeds.means[method], seeds.deviations[method]
    return [(c, look_up(mean, c.path), look_up(scatter, c.path)) for c in _columns()]


def _missing(seeds: _Seeds, method: str, column: Column) -> str:
    watched = column == TO_PAPER and {method, MEASURE} <= seeds.curves.keys()
    return NEVER if watched else NOT_MEASURED


def _summary(seeds: _Seeds, scene: str, schedule: str) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for method, results in seeds.results.items():
        content[method] = {"seeds": len(results)}
        for column, mean, scatter in _measured(seeds, method):
            content[method]["_".join(column.path)] = {"mean": mean, "std": scatter}
    return {"scene": scene, "schedule": schedule, "methods": content}
