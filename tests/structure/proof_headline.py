"""The proof's tables as documents show them: the first seed throughout, other seeds apart.

The report's page has means over seeds where there are several, and only some cells have: a row of
it may set a mean over three beside a single fit, and hold both against an `agnostic` that is
neither. Here all numbers of a row are of the same seed, those that recovery is taken of too.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from deblur_avatar.config.proof import ProofParams, load_plan
from deblur_avatar.evaluation.proof_grid import (
    Found,
    Grid,
    grid_of,
    pooled_grid,
    read_cells,
    schedules_of,
)
from deblur_avatar.reporting.proof_tables import MAIN, UNFITTED, grid_table
from deblur_avatar.reporting.results_table import (
    Cell,
    Column,
    Table,
    look_up,
    markdown,
    shown_with_spread,
)

FIRST = 0  # the seed that every cell has
READ = ("params.yaml", "experiments/proof/params.yaml", "experiments/proof/metrics")
RULE = (
    f"All of seed {FIRST}. PSNR seen in dB, larger is better; best of those that saw blur in bold. "
    "Recovery is (method \u2212 agnostic) / (oracle \u2212 agnostic) of the same avatar, scene and "
    "seed, and left open where blur costs under 0.5 dB"
)
NUMBER, SHARE = Column(("image", MAIN), "PSNR seen"), Column(("recovery", MAIN), "recovery")


def tables_of_proof(root: Path) -> str:
    """All tables of the proof that documents have, of the results in a checkout.

    Raises:
        FileNotFoundError: if there are none.
    """
    proof = root / "experiments/proof"
    if not (proof / "metrics").is_dir():
        raise FileNotFoundError(f"no results in {proof / 'metrics'}; run `make proof`")
    plan = load_plan(proof / "params.yaml")
    tables = proof_tables(plan, read_cells(plan, proof / "metrics"))
    return "\n".join(f"### {t.title}\n\n{markdown(t)}\n{t.note}\n" for t in tables)


def proof_tables(plan: ProofParams, found: Sequence[Found]) -> list[Table]:
    """The mean over report scenes, each scene that settings were not chosen on, and the seeds."""
    first = [one for one in found if one.cell.seed == FIRST]
    longer = {name for base, of in plan.windows.items() for name in of.values() if name != base}
    grids = {
        kind: {
            scene: _grid(plan, first, scene)
            for scene, own in plan.scenes.items()
            if own == kind and scene not in longer and schedules_of(first, scene)
        }
        for kind in ("report", "real_light")
    }
    of_report = list(grids["report"].values())
    tables = [
        replace(grid_table(grid, MAIN, f"{scene}: PSNR seen, dB"), note=f"{RULE}.")
        for of in grids.values()
        for scene, grid in of.items()
    ]
    if len(of_report) > 1:
        mean = grid_table(pooled_grid(of_report), MAIN, "Report scenes, mean")
        note = f"{RULE}; here of the mean PSNRs, and \u00b1 is over scenes."
        tables.insert(0, replace(mean, note=note))
    return tables + [t for scene in grids["report"] for t in _seeds(found, scene)]


def _grid(plan: ProofParams, found: Sequence[Found], scene: str) -> Grid:
    """A scene's grid in its main schedule, avatars as the plan has them."""
    grid = grid_of(found, scene, schedules_of(found, scene)[0])
    return {avatar: grid[avatar] for avatar in plan.avatars if avatar in grid}


def _seeds(found: Sequence[Found], scene: str) -> list[Table]:
    """What each seed of a scene's cells came to, where there are several; or no table."""
    schedule = schedules_of(found, scene)[0]
    seeds = sorted({one.cell.seed for one in found if one.cell.scene == scene})
    if len(seeds) < 2:
        return []
    single = [grid_of([f for f in found if f.cell.seed == s], scene, schedule) for s in seeds]
    rows = []
    for avatar, entries in grid_of(found, scene, schedule).items():
        for motion, every in entries.items():
            if len(every.seeds) == len(seeds):
                alone = [(grid[avatar][motion].mean, {}) for grid in single]
                cells = tuple(
                    Cell(
                        shown_with_spread(look_up(mean, c.path), look_up(std, c.path), c, UNFITTED)
                    )
                    for mean, std in (*alone, (every.mean, every.deviation))
                    for c in (NUMBER, SHARE)
                )
                rows.append((f"{avatar}, {motion}", cells))
    heads = [*(f"seed {seed}" for seed in seeds), "mean"]
    columns = tuple(c for head in heads for c in (Column((), head), Column((), "recovery")))
    note = (
        "PSNR seen in dB and recovery, each seed against its own agnostic and oracle; \u00b1 is "
        "over seeds, of recovery over those that have one."
    )
    title = f"{scene}: {len(seeds)} seeds"
    return [Table(columns, tuple(rows), title=title, note=note)]
