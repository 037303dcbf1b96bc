"""Make the proof: every avatar with every motion on the report scenes; docs/evidence.md.

Says first what it will take, then works off what is not there yet, two stages at a time
(`deblur-avatar sweep`), and goes on where it was stopped.
"""

import argparse
import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from deblur_avatar.cli.running_dvc import check_checkout, reproduce
from deblur_avatar.cli.sweep import sweep
from deblur_avatar.config.proof import (
    Cell,
    CostParams,
    ProofParams,
    cells_of,
    iterations_of,
    load_plan,
    seconds_of,
)
from deblur_avatar.config.reading import load_params
from deblur_avatar.errors import ConfigError
from deblur_avatar.parameters import SceneParams
from deblur_avatar.sweep.local_engine import this_machine

logger = logging.getLogger(__name__)

FOLDER = Path("experiments/proof")
PARAMS = FOLDER / "params.yaml"
LAST = ("evaluate", "learning_curve")  # stages of a cell that no other stands on
VARIABLE = re.compile(r"\$[({](\w+)")  # of the environment, in a parameter
FILES = "docs/evidence.md"  # says which file each variable names


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument("--parts", nargs="+", default=[], help="of params.yaml; default: proof.run")
    parser.add_argument("--at-once", type=int, default=2, help="stages run at a time")
    parser.add_argument("--plan", action="store_true", help="say what it would take, and stop")


def run(asked: argparse.Namespace) -> int:
    """Say what it will take, fit what is missing, write the page; returns DVC's exit code.

    Raises:
        ConfigError: if there is no such part, no scene of it can be made here, or none at a time.
    """
    check_checkout(Path())
    if asked.at_once < 1:
        raise ConfigError(f"--at-once {asked.at_once}: wanted 1 or more stages at a time")
    plan = load_plan(PARAMS)
    parts = asked.parts or list(plan.run)
    every, missing = cells_of(plan, parts), _missing_footage(plan, parts)
    cells = {name: cell for name, cell in every.items() if cell.scene not in missing}
    left = {name: cell for name, cell in cells.items() if not is_there(cell)}
    scenes = dict.fromkeys(cell.scene for cell in cells.values())
    logger.info("%s", what_it_takes(plan, cells, left, asked.at_once))
    if missing:
        logger.warning("%s", what_is_left_out(len(every) - len(cells), len(every), missing))
    if asked.plan:
        return 0
    asked_for = [target for scene in scenes for target in targets(plan, scene, cells)]
    cores, root = asked.at_once, Path()
    code = sweep(root, asked_for, cores, engine=lambda: this_machine(root, cores))
    # The page alone: of parts that were not asked for it shows what there is.
    return code or reproduce(["--single-item", str(FOLDER / "dvc.yaml")], refreshed=True)


def is_there(cell: Cell) -> bool:
    """Whether a cell's results are; DVC alone knows whether they are of today's code."""
    return (FOLDER / "metrics" / cell.scene / "learning_curve" / f"{cell.name}.json").exists()


def what_it_takes(
    plan: ProofParams, cells: dict[str, Cell], left: dict[str, Cell], at_once: int
) -> str:
    """Cells and hours of one core, by scene and schedule."""
    iterations, costs = iterations_of(PARAMS), load_params(PARAMS, "costs", CostParams)
    lines = [f"{len(cells)} cells, {len(cells) - len(left)} of them there already."]
    total = 0.0
    for scene in dict.fromkeys(cell.scene for cell in cells.values()):
        own = [cell for cell in left.values() if cell.scene == scene]
        seconds = seconds_of(plan, costs, own, iterations)
        total += seconds
        schedules = ", ".join(dict.fromkeys(cell.schedule for cell in own))
        lines.append(f"  {scene}: {len(own)} cells ({schedules}), {seconds / 60:.0f} min")
    lines.append(
        f"In all {total / 3600:.1f} hours of one core ({costs.machine}); with {at_once} stages at "
        f"a time not less than {total / 3600 / at_once:.1f} hours."
    )
    return "\n".join(lines)


def what_is_left_out(number: int, of: int, missing: Mapping[str, Sequence[str]]) -> str:
    """How many cells cannot be made here, and what would let them be.

    Args:
        number: of cells that are left out.
        of: how many were asked for.
        missing: of each scene without its files, the variables that would name them.
    """
    return (
        f"Left out, and in none of these figures: {number} of {of} cells, those of "
        f"{', '.join(missing)}{_to_set(missing)}."
    )


def targets(plan: ProofParams, scene: str, cells: Mapping[str, Cell]) -> list[str]:
    """What to ask DVC for of one scene; what that stands on follows from the pipelines."""
    own = [cell.name for cell in cells.values() if cell.scene == scene]
    return [f"{FOLDER / scene}/dvc.yaml:{stage}@{name}" for name in own for stage in LAST]


def _missing_footage(plan: ProofParams, parts: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Scenes that cannot be made here, each named in the log, and the variables of each.

    Raises:
        ConfigError: if that is all of them.
    """
    missing = {}
    scenes = dict.fromkeys(cell.scene for cell in cells_of(plan, parts).values())
    for scene in scenes:
        file = Path("params.yaml") if scene in plan.filmed_at_root else PARAMS
        params = load_params(file, f"scenes.{scene}", SceneParams)
        reasons = params.clip.missing_files(f"scenes.{scene}.clip")
        if reasons:
            missing[scene] = tuple(VARIABLE.findall(params.clip.model_dump_json()))
            because = "; ".join(reasons) + _to_set({scene: missing[scene]})
            logger.warning("scene %s is left out: %s", scene, because)
    if missing.keys() == scenes.keys():
        raise ConfigError(f"no scene of {', '.join(parts)} can be made here{_to_set(missing)}")
    return missing


def _to_set(missing: Mapping[str, Iterable[str]]) -> str:
    """The end of a sentence about scenes without files: what variables would name them."""
    names = dict.fromkeys(name for of in missing.values() for name in of)
    return f"; set {', '.join(names)}, which {FILES} explains" if names else ""
