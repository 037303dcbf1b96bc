"""The proof's grid: what cells measured, compared within one avatar and averaged over seeds.

Conventions. A *result* is a cell's metrics file with its costs, as `evaluation.recovery` has them.
Rows are avatars, columns motions; recovery is of a method against the bounds of its own avatar, in
its own schedule, scene and seed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deblur_avatar.config.proof import MOTIONS, Cell, ProofParams, cells_of, warmup_of
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.costs import read_costs, with_seconds
from deblur_avatar.evaluation.metrics import METRICS
from deblur_avatar.evaluation.recovery import Result, averaged, compared, standard_deviations
from deblur_avatar.files import read_json


@dataclass(frozen=True)
class Found:
    """What is there of one cell."""

    cell: Cell
    result: Result
    curve: Result | None


@dataclass(frozen=True)
class Entry:
    """One entry of a grid: a mean over seeds and its scatter."""

    seeds: tuple[int, ...]
    mean: Result
    deviation: Result


Grid = dict[str, dict[str, Entry]]  # by avatar and motion


def read_cells(plan: ProofParams, metrics: Path) -> list[Found]:
    """All cells of the plan that have results.

    Raises:
        ArtifactError: if a file is damaged.
    """
    found = []
    for cell in cells_of(plan).values():
        folder = metrics / cell.scene
        path = folder / "evaluate" / f"{cell.name}.json"
        if not path.exists():
            continue
        content = read_json(path)
        method = plan.columns[cell.motion].method
        if (content.get("scene"), content.get("method")) != (cell.scene, method):
            raise ArtifactError(f"{path} is not of {method} on {cell.scene}; run `make proof`")
        items = {"warmup": warmup_of(cell, plan)} | dict.fromkeys(
            ("trajectory", "fusion", "evaluate"), cell.name
        )
        files = {stage: folder / "cost" / stage / f"{item}.json" for stage, item in items.items()}
        curve = folder / "learning_curve" / f"{cell.name}.json"
        found.append(
            Found(
                cell,
                content | {"cost": read_costs(files)},
                with_seconds(read_json(curve), files) if curve.exists() else None,
            )
        )
    return found


def grid_of(found: Sequence[Found], scene: str, schedule: str) -> Grid:
    """One scene's grid in one schedule: recovery within each avatar and seed, then the mean."""
    here = [one for one in found if (one.cell.scene, one.cell.schedule) == (scene, schedule)]
    grid: Grid = {}
    for avatar in dict.fromkeys(one.cell.avatar for one in here):
        seeds: dict[int, dict[str, Result]] = {}
        for one in here:
            if one.cell.avatar == avatar:
                seeds.setdefault(one.cell.seed, {})[one.cell.motion] = one.result
        results = {seed: compared(motions) for seed, motions in seeds.items()}
        grid[avatar] = {
            motion: _entry({s: r[motion] for s, r in results.items() if motion in r})
            for motion in MOTIONS
            if any(motion in motions for motions in seeds.values())
        }
    return grid


def pooled_grid(grids: Sequence[Grid]) -> Grid:
    """The mean over scenes of cells that all of them have; its scatter is over scenes.

    An avatar without such a cell has no row.

    Recovery is that of the means, not the mean of recoveries, which a scene with little blur would
    rule.
    """
    pooled: Grid = {}
    for avatar in dict.fromkeys(avatar for grid in grids for avatar in grid):
        rows = [grid.get(avatar, {}) for grid in grids]
        common = [motion for motion in rows[0] if all(motion in row for row in rows)]
        if not common:
            continue
        means = compared({m: averaged([row[m].mean for row in rows]) for m in common})
        pooled[avatar] = {
            motion: Entry(
                tuple(sorted({seed for row in rows for seed in row[motion].seeds})),
                means[motion],
                standard_deviations([row[motion].mean for row in rows]),
            )
            for motion in common
        }
    return pooled


def _entry(results: Mapping[int, Result]) -> Entry:
    every = list(results.values())
    return Entry(tuple(sorted(results)), averaged(every), standard_deviations(every))


def schedules_of(found: Sequence[Found], scene: str) -> list[str]:
    """The schedules that a scene has cells in: those with most cells first, then the longest."""
    here = [one for one in found if one.cell.scene == scene]
    names = [one.cell.schedule for one in here]
    lengths = {one.cell.schedule: one.result["run"]["iterations"] for one in here}
    return sorted(lengths, key=lambda name: (-names.count(name), -lengths[name]))


def in_main_schedule(found: Sequence[Found], scene: str) -> list[Found]:
    """A scene's cells in the first of its schedules."""
    main = schedules_of(found, scene)[:1]
    return [one for one in found if one.cell.scene == scene and one.cell.schedule in main]


def numbers_of(entry: Entry | None) -> dict[str, Any] | None:
    """An entry as `summary.json` has it; None for a cell that nobody fitted."""
    if entry is None:
        return None
    mean, scatter = entry.mean, entry.deviation
    images = {
        row.name: {
            "mean": (mean.get("image") or {}).get(row.name),
            "std": (scatter.get("image") or {}).get(row.name),
        }
        for row in METRICS
    }
    return {
        **images,
        "recovery": mean["recovery"],
        "recovery_std": scatter.get("recovery") or {},
        "gap_to_ceiling_db": mean["gap_to_ceiling_db"],
        "train_s": mean["cost"]["train_s"],
        "gaussians": mean["model"]["gaussians"],
        "seeds": list(entry.seeds),
    }
