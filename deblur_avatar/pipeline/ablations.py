"""The paper's ablations in the form of its tables: means and spreads over seeds.

Conventions. A spread is the standard deviation over seeds (n - 1). Recovery is taken within each
seed, against that seed's own `blind` and `oracle`. What the paper measured stands beside, from
another data set (ZJU-MoCap with synthetic blur): only which row is better can be compared.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2

from deblur_avatar import run
from deblur_avatar.errors import ArtifactError
from deblur_avatar.pipeline.comparison import Result, averaged, compared, spread
from deblur_avatar.pipeline.report import chart_files, read_results
from deblur_avatar.pipeline.results_table import (
    DRAWING,
    FLIP,
    GAUSSIANS,
    LPIPS,
    PSNR,
    RECOVERY,
    SEEN,
    SSIM,
    TRAINING,
    Column,
    look_up,
    shown_with_spread,
)
from deblur_avatar.pipeline.speed_accuracy import Row, rows_of_methods, with_speed

TEMPLATE = "ablations.html.jinja"
MEMORY = Column(("cost", "peak_memory_mb"), "memory", "MB", 0, -1)
SIZE = Column(("model", "megabytes"), "size", "MB", 1, -1)
SSIM_RANGE_2 = Column(("image", "ssim_range2"), "SSIM (range 2)", "", 4, 1)
COLUMNS = (PSNR, SSIM_RANGE_2, SSIM, LPIPS, FLIP, SEEN, RECOVERY, TRAINING, DRAWING, MEMORY,
           GAUSSIANS, SIZE)  # fmt: skip

# arXiv 2501.13335: means over six scenes (ablations), scene 377 (number of virtual poses); PSNR dB,
# SSIM, LPIPS x 1000.
ABLATIONS = {
    "no_nonrigid": ("29.43", "0.9659", "38.12"),
    "blind": ("30.05", "0.9668", "37.95"),
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
            "blind": "without motion modelling",
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
            "blind": "blind",
            "predeblur": "deblurred in the picture, then blind",
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
        """Write `index.html`, `tables.md`, `summary.json` and the chart `speed_accuracy`.

        Raises:
            ArtifactError: if the disk refuses.
        """
        files = {"index.html": self.page.encode(), "tables.md": self.tables.encode()}
        for file, content in (files | self.charts).items():
            run.write_bytes(folder / file, content)
        run.write_json(folder / "summary.json", self.summary)


def report_ablations(folder: Path, scene: str, schedule: str) -> AblationReport:
    """Gather `seed_*/metrics/<scene>/<method>.json` below a folder.

    Raises:
        ArtifactError: if no seed has results of the scene, or a file is damaged.
    """
    seeds = [
        compared(results[scene])
        for path in sorted(folder.glob("seed_*/metrics"))
        if scene in (results := read_results(path))
    ]
    if not seeds:
        raise ArtifactError(f"no results of {scene} below {folder}; run `dvc repro` there")
    about = f"Scene {scene}, schedule {schedule}, novel views, {len(seeds)} seeds: mean ± spread."
    tables = [table for section in SECTIONS if len((table := _table(section, seeds))[1]) > 1]
    text = f"{about} Grey columns: the paper's own numbers, of another data set.\n\n"
    text += "\n".join(_markdown(section, table) for section, table in tables)
    charts = chart_files("speed_accuracy", _rows(seeds, scene))
    picture = charts.get("speed_accuracy.svg", b"").decode()
    return AblationReport(
        _page(about, tables, picture), text, _summary(seeds, scene, schedule), charts
    )


def _rows(seeds: Sequence[Mapping[str, Result]], scene: str) -> list[Row]:
    """Means over seeds, with their spreads and the Pareto front of the means."""
    methods = dict.fromkeys(method for results in seeds for method in results)
    every = {m: [results[m] for results in seeds if m in results] for m in methods}
    means = with_speed({m: averaged(results) for m, results in every.items()}, {})
    return rows_of_methods({scene: means}, {m: spread(results) for m, results in every.items()})


def _table(
    section: Section, seeds: Sequence[Mapping[str, Result]]
) -> tuple[Section, list[list[str]]]:
    """Heads and rows of text; methods that nobody has run are left out."""
    heads = ["", *(f"{c.label} {c.unit}".strip() for c in COLUMNS)]
    if section.paper:
        heads += ["paper*: PSNR", "paper*: SSIM", "paper*: LPIPS"]
    rows = [heads]
    for method, label in section.rows.items():
        results = [results[method] for results in seeds if method in results]
        if results:
            cells = [shown_with_spread(*both, column) for column, both in _measured(results)]
            rows.append([label, *cells, *(section.paper.get(method, ()))])
    return section, rows


def _measured(results: Sequence[Result]) -> list[tuple[Column, tuple[float | None, float | None]]]:
    """Each column's mean and spread over results of one method."""
    mean, scatter = averaged(results), spread(results)
    return [(c, (look_up(mean, c.path), look_up(scatter, c.path))) for c in COLUMNS]


def _markdown(section: Section, rows: list[list[str]]) -> str:
    lines = [rows[0], ["---", *["---:"] * (len(rows[0]) - 1)], *rows[1:]]
    table = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    return f"### {section.title}\n\n{section.note}\n\n{table}"


def _summary(seeds: Sequence[Mapping[str, Result]], scene: str, schedule: str) -> dict[str, Any]:
    methods = dict.fromkeys(method for results in seeds for method in results)
    content: dict[str, Any] = {}
    for method in methods:
        results = [results[method] for results in seeds if method in results]
        content[method] = {"seeds": len(results)}
        for column, (mean, scatter) in _measured(results):
            content[method]["_".join(column.path)] = {"mean": mean, "spread": scatter}
    return {"scene": scene, "schedule": schedule, "methods": content}


def _page(about: str, tables: list[tuple[Section, list[list[str]]]], chart: str) -> str:
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string((Path(__file__).parent / TEMPLATE).read_text())
    return template.render(about=about, tables=tables, columns=len(COLUMNS), chart=chart) + "\n"
