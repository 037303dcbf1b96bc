"""Make the proof: every avatar with every motion on the report scenes; docs/evidence.md.

Says first what it will take, then works off what is not there yet, two scenes at a time, and goes
on where it was stopped.
"""

import argparse
import logging
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from deblur_avatar.cli.running_dvc import check_checkout, reproduce
from deblur_avatar.config.proof import (
    Cell,
    ProofParams,
    cells_of,
    iterations_of,
    load_plan,
    seconds_of,
    warmup_of,
)
from deblur_avatar.config.reading import load_params
from deblur_avatar.errors import ConfigError
from deblur_avatar.parameters import SceneParams

logger = logging.getLogger(__name__)

FOLDER = Path("experiments/proof")
PARAMS = FOLDER / "params.yaml"
STAGES = ("trajectory", "fusion", "evaluate", "learning_curve")  # of a cell, in their order
MADE_ONCE = ("body@anny",)  # of the root's pipeline


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument("--parts", nargs="+", default=[], help="of params.yaml; default: proof.run")
    parser.add_argument("--at-once", type=int, default=2, help="scenes worked on at a time")
    parser.add_argument("--plan", action="store_true", help="say what it would take, and stop")


def run(asked: argparse.Namespace) -> int:
    """Say what it will take, fit what is missing, write the page; returns DVC's exit code.

    Raises:
        ConfigError: if there is no such part, no scene of it can be made here, or none at a time.
    """
    check_checkout(Path())
    if asked.at_once < 1:
        raise ConfigError(f"--at-once {asked.at_once}: wanted 1 or more scenes at a time")
    plan = load_plan(PARAMS)
    parts = asked.parts or list(plan.run)
    missing = _missing_footage(plan, parts)
    cells = {
        name: cell for name, cell in cells_of(plan, parts).items() if cell.scene not in missing
    }
    left = {name: cell for name, cell in cells.items() if not is_there(cell)}
    scenes = in_order(plan, cells, left)
    logger.info("%s", what_it_takes(plan, cells, left, asked.at_once))
    if asked.plan:
        return 0
    code = reproduce(roots_stages(plan, scenes))
    if code:
        return code
    with ThreadPoolExecutor(asked.at_once) as pool:
        codes = list(pool.map(lambda scene: _reproduce_scene(plan, scene, cells), scenes))
    failed = [code for code in codes if code]
    if failed:
        return failed[0]
    return reproduce(["--single-item", str(FOLDER / "dvc.yaml")], refreshed=True)


def is_there(cell: Cell) -> bool:
    """Whether a cell's results are; DVC alone knows whether they are of today's code."""
    return (FOLDER / "metrics" / cell.scene / "learning_curve" / f"{cell.name}.json").exists()


def in_order(plan: ProofParams, cells: dict[str, Cell], left: dict[str, Cell]) -> list[str]:
    """The scenes, those with most to do first, so that none is alone at the end."""
    iterations = iterations_of(PARAMS)
    work = {
        scene: seconds_of(plan, [c for c in left.values() if c.scene == scene], iterations)
        for scene in dict.fromkeys(cell.scene for cell in cells.values())
    }
    return sorted(work, key=lambda scene: -work[scene])


def what_it_takes(
    plan: ProofParams, cells: dict[str, Cell], left: dict[str, Cell], at_once: int
) -> str:
    """Cells and hours of one core, by scene and schedule."""
    iterations = iterations_of(PARAMS)
    lines = [f"{len(cells)} cells, {len(cells) - len(left)} of them there already."]
    total = 0.0
    for scene in dict.fromkeys(cell.scene for cell in cells.values()):
        own = [cell for cell in left.values() if cell.scene == scene]
        seconds = seconds_of(plan, own, iterations)
        total += seconds
        schedules = ", ".join(dict.fromkeys(cell.schedule for cell in own))
        lines.append(f"  {scene}: {len(own)} cells ({schedules}), {seconds / 60:.0f} min")
    costs = plan.costs
    lines.append(
        f"In all {total / 3600:.1f} hours of one core ({costs.machine}); with {at_once} scenes at "
        f"a time not less than {total / 3600 / at_once:.1f} hours."
    )
    return "\n".join(lines)


def roots_stages(plan: ProofParams, scenes: Sequence[str]) -> list[str]:
    """Targets of the pipeline at the root that the scenes stand on."""
    shared = [name for name in scenes if plan.scenes[name].filmed == "root"]
    return [*MADE_ONCE, *(f"preprocess@{name}" for name in shared)]


def targets(plan: ProofParams, scene: str, cells: Sequence[Cell]) -> list[str]:
    """What to ask DVC for, each after what it stands on."""
    pipeline = f"{FOLDER / scene}/dvc.yaml"
    here = plan.scenes[scene].filmed == "here"
    items = [f"{stage}@{scene}" for stage in ("clip", "blur", "preprocess") if here]
    items += dict.fromkeys(f"warmup@{warmup_of(cell, plan)}" for cell in cells)
    items += [f"{stage}@{cell.name}" for cell in cells for stage in STAGES]
    return [f"{pipeline}:{item}" for item in items]


def _reproduce_scene(plan: ProofParams, scene: str, cells: dict[str, Cell]) -> int:
    own = [cell for cell in cells.values() if cell.scene == scene]
    # Single items: two processes must not both refresh what all stand on.
    return reproduce(["--single-item", *targets(plan, scene, own)], refreshed=True)


def _missing_footage(plan: ProofParams, parts: Sequence[str]) -> set[str]:
    """Scenes that cannot be made here; each is named in the log."""
    missing = set()
    for scene in dict.fromkeys(cell.scene for cell in cells_of(plan, parts).values()):
        params = load_params(PARAMS if plan.scenes[scene].filmed == "here" else Path("params.yaml"),
                             f"scenes.{scene}", SceneParams)  # fmt: skip
        reasons = params.clip.missing_files(f"scenes.{scene}.clip")
        if reasons:
            logger.warning("scene %s is left out: %s", scene, "; ".join(reasons))
            missing.add(scene)
    if not missing:
        return missing
    if missing == {cell.scene for cell in cells_of(plan, parts).values()}:
        raise ConfigError(f"no scene of {', '.join(parts)} can be made here")
    return missing
