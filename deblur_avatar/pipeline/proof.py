"""The proof: every avatar with every motion, on scenes that no setting was chosen on.

Recovery is taken within each avatar, scene, schedule and seed. Cells that nobody has fitted are
null. Equal results give equal bytes.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deblur_avatar.config.proof import MOTIONS, ProofParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.metrics import metric
from deblur_avatar.evaluation.proof_grid import (
    Found,
    Grid,
    grid_of,
    in_main_schedule,
    numbers_of,
    pooled_grid,
    read_cells,
    schedules_of,
)
from deblur_avatar.files import write_bytes, write_json
from deblur_avatar.pipeline.proof_strips import SHOWN, current_strips
from deblur_avatar.reporting.charts import drawn
from deblur_avatar.reporting.kept_strips import KeptStrips
from deblur_avatar.reporting.page import render_page
from deblur_avatar.reporting.picture_strips import INPUT, TRUTH
from deblur_avatar.reporting.proof_charts import quality_chart
from deblur_avatar.reporting.proof_tables import (
    MAIN,
    UNFITTED,
    UNKNOWN,
    convergence_table,
    cost_table,
    curve_of,
    grid_table,
    windows_table,
)
from deblur_avatar.reporting.results_table import Table, look_up, markdown, plain
from deblur_avatar.reporting.stopping_table import stopping_table

TEMPLATE = Path(__file__).parent / "proof.html.jinja"
GRIDS = ("psnr_seen", "psnr", "flip")
HEADLINES = ("paper", "mad", "clip")  # motions whose recovery stands above all tables
CHART = "quality_over_time"
KINDS = ("report", "real_light", "tuning")  # of scenes, as they stand on the page
QUALITY = "PSNR of the seen surface, dB"


@dataclass(frozen=True)
class ProofReport:
    """A page, its tables for reading in a repository, and the numbers behind them."""

    page: str
    tables: str
    headline: str  # of them the mean, and one of each scene that nothing was tuned on
    summary: dict[str, Any]
    charts: dict[str, bytes]  # files by name
    log: str

    def save(self, folder: Path) -> None:
        """Write `index.html`, `tables.md`, `headline.md`, `summary.json`, the chart and its rows.

        Raises:
            ArtifactError: if the disk refuses.
        """
        texts = {"index.html": self.page, "tables.md": self.tables, "headline.md": self.headline}
        files = {name: text.encode() for name, text in texts.items()}
        for file, content in (files | self.charts).items():
            write_bytes(folder / file, content)
        write_json(folder / "summary.json", self.summary)


def report_proof(plan: ProofParams, metrics: Path, strips: Path) -> ProofReport:
    """Gather what the cells of a plan left.

    Args:
        plan: what was to be fitted.
        metrics: `<scene>/<stage>/<cell>.json` and `<scene>/cost/<stage>/<cell>.json`.
        strips: pictures by scene and avatar, in a folder beside the page.

    Raises:
        ArtifactError: if no cell has results, or a file is damaged.
    """
    found = read_cells(plan, metrics)
    if not found:
        raise ArtifactError(f"no results in {metrics}; run `make proof`")
    grids = _grids(plan, found)
    whole = {scene: grids[scene] for scene in _in_order(plan) if scene in grids}
    overall = _overall(plan, whole)
    windows = _windows(plan, grids)
    converged, stopped = _converged(plan, found), _stopped(found, whole)
    curves = {scene: kept for scene in whole if (kept := _curves(found, scene))}
    quality = drawn(CHART, lambda: quality_chart(curves, QUALITY)) if curves else {}
    tables = {scene: _tables(scene, grid) for scene, grid in whole.items()}
    page = render_page(
        TEMPLATE,
        about=_about(plan, found),
        figures=_figures(overall),
        overall=[] if overall is None else [grid_table(overall, n, _title(n)) for n in GRIDS],
        quiet=(UNFITTED, UNKNOWN),
        scenes=[
            {
                "name": scene,
                "about": _about_scene(plan, found, scene),
                "tables": tables[scene],
                "views": _views(plan, found, scene, strips),
            }
            for scene in whole
        ],
        windows=windows,
        converged=converged,
        stopped=stopped,
        quality=quality[f"{CHART}.svg"].decode() if quality else "",
    )
    first = [] if overall is None else [grid_table(overall, MAIN, "Report scenes, mean")]
    every = [*first, *(t for of in tables.values() for t in of), *windows, *converged, *stopped]
    shown = [*first, *(tables[s][0] for s in whole if plan.scenes[s] != "tuning")]
    return ProofReport(
        page=page,
        tables="\n".join(_markdown(given) for given in every),
        headline="\n".join(_markdown(given) for given in shown),
        summary=_summary(plan, grids),
        charts={**quality, f"{CHART}.json": _rows(curves)},
        log="\n\n".join(
            f"{t.title}\n{plain(t)}" for t in (*first, *(of[0] for of in tables.values()))
        ),
    )


def _grids(plan: ProofParams, found: Sequence[Found]) -> dict[str, Grid]:
    """Each scene's grid in the schedule that most of its cells have."""
    grids = {}
    for scene in plan.scenes:
        schedules = schedules_of(found, scene)
        if schedules:
            grid = grid_of(found, scene, schedules[0])
            grids[scene] = {avatar: grid[avatar] for avatar in plan.avatars if avatar in grid}
    return grids


def _in_order(plan: ProofParams) -> list[str]:
    """Scenes that stand alone, report scenes first, those in real light next."""
    alone = [scene for scene in plan.scenes if scene not in _windowed(plan)]
    return sorted(alone, key=lambda scene: KINDS.index(plan.scenes[scene]))


def _overall(plan: ProofParams, grids: Mapping[str, Grid]) -> Grid | None:
    """The mean over the report scenes, where there are several."""
    of_report = [grid for scene, grid in grids.items() if plan.scenes[scene] == "report"]
    return pooled_grid(of_report) if len(of_report) > 1 else None


def _windowed(plan: ProofParams) -> set[str]:
    """Scenes that another is seen in a longer or shorter exposure in."""
    return {s for scene, group in plan.windows.items() for s in group.values() if s != scene}


def _windows(plan: ProofParams, grids: Mapping[str, Grid]) -> list[Table]:
    tables = []
    for scene, group in plan.windows.items():
        there = {window: grids[name] for window, name in sorted(group.items()) if name in grids}
        if len(there) > 1:
            tables.append(windows_table(there, MAIN, f"{scene}: windows of sub-frames of 1/480 s"))
    return tables


def _converged(plan: ProofParams, found: Sequence[Found]) -> list[Table]:
    """What longer schedules and the second half of each fit still brought."""
    return [
        convergence_table([one for one in found if one.cell.scene == scene], scene)
        for scene in plan.scenes
        if scene not in _windowed(plan) and schedules_of(found, scene)
    ]


def _stopped(found: Sequence[Found], scenes: Iterable[str]) -> list[Table]:
    """What other rules of stopping would have made of the first seed of each scene's grid."""
    return [stopping_table(of, scene) for scene in scenes if (of := _first_seed(found, scene))]


def _tables(scene: str, grid: Grid) -> list[Table]:
    return [
        *(grid_table(grid, name, f"{scene}: {_title(name)}") for name in GRIDS),
        cost_table(grid, f"{scene}: what it took"),
    ]


def _title(name: str) -> str:
    row = metric(name)
    return f"{row.title}, {row.unit}" if row.unit else row.title


def _curves(found: Sequence[Found], scene: str) -> dict[str, dict[str, list[tuple[float, float]]]]:
    """Seconds and quality of the snapshots of the first seed, in the scene's main schedule."""
    curves: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for one in _first_seed(found, scene):
        if curve := curve_of(one):
            curves.setdefault(one.cell.avatar, {}).setdefault(one.cell.motion, curve)
    return curves


def _first_seed(found: Sequence[Found], scene: str) -> list[Found]:
    """The scene's cells in its main schedule, each in the first seed that has a curve."""
    first: dict[tuple[str, str], Found] = {}
    for one in in_main_schedule(found, scene):
        if curve_of(one):
            first.setdefault((one.cell.avatar, one.cell.motion), one)
    return list(first.values())


def _rows(curves: Mapping[str, Mapping[str, Mapping[str, Sequence[tuple[float, float]]]]]) -> bytes:
    rows = [
        {"scene": scene, "avatar": avatar, "motion": motion, "training_s": round(seconds, 2),
         "psnr_seen_db": round(psnr, 3)}
        for scene, avatars in curves.items()
        for avatar, motions in avatars.items()
        for motion, curve in motions.items()
        for seconds, psnr in curve
    ]  # fmt: skip
    return (json.dumps(rows, indent=1) + "\n").encode()


def _summary(plan: ProofParams, grids: Mapping[str, Grid]) -> dict[str, Any]:
    return {
        "scenes": {
            scene: {
                "kind": plan.scenes[scene],
                "grid": {
                    avatar: {m: numbers_of(grid.get(avatar, {}).get(m)) for m in MOTIONS}
                    for avatar in plan.avatars
                },
            }
            for scene, grid in grids.items()
        }
    }


def _about(plan: ProofParams, found: Sequence[Found]) -> str:
    report = [scene for scene, kind in plan.scenes.items() if kind == "report"]
    shown = len({one.cell.scene for one in found} & set(report) - _windowed(plan))
    filmed = {one.cell.scene for one in found if plan.scenes[one.cell.scene] == "real_light"}
    real = f", and {len(filmed)} in real light" if filmed else ""
    avatars, motions = ({getattr(one.cell, of) for one in found} for of in ("avatar", "motion"))
    return (
        f"{len(avatars)} avatars, {len(motions)} motions, {len(found)} fits; "
        f"{shown} report scenes, on which no setting was chosen and whose truth is not the "
        f"fitter's own model{real}. Recovery is the share of what blur costs an avatar that a "
        "motion wins back for it: (method \u2212 agnostic) / (oracle \u2212 agnostic), all of the "
        "same avatar."
    )


def _about_scene(plan: ProofParams, found: Sequence[Found], scene: str) -> str:
    kind = {
        "report": "A report scene: made once, run once with frozen settings.",
        "real_light": "A report scene in real light: sums of a fast camera's frames, scored "
        "against those frames, from the filming camera alone; run once with frozen settings.",
        "tuning": "A tuning scene: settings were chosen on it, so its figures prove nothing.",
    }[plan.scenes[scene]]
    here = [one.cell for one in found if one.cell.scene == scene]
    seeds = sorted({cell.seed for cell in here})
    schedule = schedules_of(found, scene)[0]
    iterations = next(one.result["run"]["iterations"] for one in found
                      if (one.cell.scene, one.cell.schedule) == (scene, schedule))  # fmt: skip
    spread = f"; {len(seeds)} seeds where a \u00b1 stands" if len(seeds) > 1 else "; one seed"
    return f"{kind} {iterations:,} iterations ({schedule}){spread}."


def _figures(overall: Grid | None) -> list[dict[str, str]]:
    """What each avatar's motions win back over all report scenes."""
    return [
        {
            "number": f"{share:.2f}".replace("-", "\u2212"),
            "caption": f"of what blur costs, {motion} on {avatar} wins back",
        }
        for avatar, entries in (overall or {}).items()
        for motion in HEADLINES
        if motion in entries
        and (share := look_up(entries[motion].mean, ("recovery", MAIN))) is not None
    ]


def _views(
    plan: ProofParams, found: Sequence[Found], scene: str, strips: Path
) -> list[dict[str, Any]]:
    """Each view with a row an avatar: the input, motions as they stand in the grid, the truth."""
    if scene in plan.without_pictures:
        return []
    kept = {
        avatar: of
        for avatar in plan.avatars
        if (of := current_strips(strips, found, scene, avatar)) is not None
    }
    motions = [motion for motion in SHOWN if any(motion in of.fits for of in kept.values())]
    captions = dict.fromkeys(caption for of in kept.values() for caption in of.captions)
    return [
        {
            "caption": caption,
            "columns": len(motions) + 2,
            "rows": [
                _row(avatar, of, of.captions.index(caption), motions, strips)
                for avatar, of in kept.items()
                if caption in of.captions
            ],
        }
        for caption in captions
    ]


def _row(
    avatar: str, of: KeptStrips, view: int, motions: Sequence[str], strips: Path
) -> list[dict[str, str]]:
    """Labels and files from the page on; neither where there is no picture."""
    there = {INPUT: INPUT, **{motion: f"{avatar} {motion}" for motion in of.fits}}
    if of.truth:
        there[TRUTH] = TRUTH
    return [
        {
            "label": there[label],
            "file": of.picture(view, label).relative_to(strips.parent).as_posix(),
        }
        if label in there
        else {"label": "", "file": ""}
        for label in (INPUT, *motions, TRUTH)
    ]


def _markdown(given: Table) -> str:
    return f"### {given.title}\n\n{markdown(given)}\n{given.note}\n"
