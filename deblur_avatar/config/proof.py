"""The proof's plan: which avatar meets which motion on which scene, how long and how often.

Conventions. A *cell* is one fit: an avatar, a motion column, a schedule and a seed on one scene. It
is named `<avatar>-<motion>-<schedule>-seed_<n>`; what cells of the same observations share is a
warm-up, `<avatar>-<observations>-<schedule>-seed_<n>`. Costs are seconds of one core.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from deblur_avatar.config.reading import load_params
from deblur_avatar.config.section import Count, NonNegative, Params, Positive
from deblur_avatar.errors import ConfigError

PIPELINE = "scene.dvc.yaml"  # what each scene's pipeline is a copy of
WRITTEN = "Written by `make code` from what params.yaml says above."
# What may be a column: tables have all of them, fitted or not.
MOTIONS = (
    "agnostic",
    "deblurred",
    "pair",
    "paper",
    "mad",
    "clip",
    "oracle",
    "oracle_clip",
    "ceiling",
)
FLOOR = "agnostic"  # the motion whose fit a warm-up's cost is a share of


class ColumnParams(Params):
    """One column of the grid: a method of the shared file, and what it sees."""

    observations: Literal["exact", "sharp", "blurred", "deblurred"]
    method: str


# What a scene's figures may be used for. One in `real_light` is a report scene that was filmed, not
# made: it has no exact poses and is in no mean with those that have.
SceneKind = Literal["report", "real_light", "tuning"]


class PartParams(Params):
    """Some cells: every one of its avatars' columns, scenes, schedules and seeds."""

    scenes: tuple[str, ...]
    schedules: tuple[str, ...]
    seeds: Count  # how many, from 0
    cells: dict[str, tuple[str, ...]]  # columns by avatar


class CostParams(Params):
    """Measured seconds of one core, on `machine` (`costs`)."""

    machine: str
    schedule: str  # that the fits were measured with
    fits: dict[str, dict[str, Positive]]  # by avatar and column, the warm-up included
    scene: NonNegative  # filming, blurring and preparing one scene
    scores: NonNegative  # evaluating one cell and its learning curve
    starts: NonNegative  # what starting its stages takes a cell


class ProofParams(Params):
    """The whole plan (`proof`)."""

    avatars: dict[str, str]  # rows: entries of `avatars`, by the name that tables give them
    columns: dict[str, ColumnParams]
    scenes: dict[str, SceneKind]
    filmed_at_root: tuple[str, ...]  # scenes whose footage the pipeline at the root makes
    windows: dict[str, dict[Count, str]]  # scenes that differ in it alone: sub-frames to scene
    without_pictures: tuple[str, ...]  # scenes of which the page shows none
    parts: dict[str, PartParams]
    run: tuple[str, ...]  # parts that `make proof` runs unless others are asked for


@dataclass(frozen=True)
class Cell:
    """One fit."""

    scene: str
    avatar: str
    motion: str
    schedule: str
    seed: int

    @property
    def name(self) -> str:
        """Its name among those of its scene."""
        return f"{self.avatar}-{self.motion}-{self.fit}"

    @property
    def fit(self) -> str:
        """Of schedule and seed: the parameter file that its stages read."""
        return f"{self.schedule}-seed_{self.seed}"


def load_plan(path: Path) -> ProofParams:
    """Read the plan of a parameter file, and check every name in it.

    Raises:
        ConfigError: for a section that cannot be run, or a name that stands for nothing.
    """
    plan: ProofParams = load_params(path, "proof", ProofParams)
    for name in plan.columns.keys() - set(MOTIONS):
        raise ConfigError(
            f"{path}: proof.columns: no table has a column {name!r}; there is {', '.join(MOTIONS)}"
        )
    known = {
        "scenes": plan.scenes.keys(),
        "schedules": load_params(path, "schedules", dict).keys(),
        "avatars": plan.avatars.keys(),
        "columns": plan.columns.keys(),
    }
    for name, part in plan.parts.items():
        named = {
            "scenes": part.scenes,
            "schedules": part.schedules,
            "avatars": part.cells.keys(),
            "columns": [column for columns in part.cells.values() for column in columns],
        }
        for section, names in named.items():
            for unknown in set(names) - set(known[section]):
                raise ConfigError(
                    f"{path}: proof.parts.{name}: no {unknown!r} among the {section}; there is "
                    f"{', '.join(known[section])}"
                )
    cells_of(plan, plan.run)
    _check_shared(path, plan)
    return plan


def _check_shared(path: Path, plan: ProofParams) -> None:
    """What the plan names of other sections, and what it calls them by, is there."""
    scenes = load_params(path, "scenes", dict)
    methods = {column.method for column in plan.columns.values()}
    windows = {scene for group in plan.windows.values() for scene in group.values()}
    wanted = {
        "scenes": plan.scenes.keys() - set(plan.filmed_at_root),
        "avatars": set(plan.avatars.values()),
        "methods": methods,
    }
    for section, names in wanted.items():
        there = scenes if section == "scenes" else load_params(path, section, dict)
        for name in sorted(names - there.keys()):
            raise ConfigError(f"{path}: proof: {section} has no {name!r}")
    named = {
        "windows": windows | plan.windows.keys(),
        "filmed_at_root": {*plan.filmed_at_root},
        "without_pictures": {*plan.without_pictures},
    }
    for section, names in named.items():
        for name in sorted(names - plan.scenes.keys()):
            raise ConfigError(
                f"{path}: proof.{section}: there is no scene {name!r} in proof.scenes"
            )


def cells_of(plan: ProofParams, parts: Sequence[str] | None = None) -> dict[str, Cell]:
    """All cells of some parts by `<scene>/<name>`, each once although parts may share it.

    Args:
        plan: what there is.
        parts: names of parts; None: all of them.

    Raises:
        ConfigError: if there is no such part.
    """
    found = {}
    for name in plan.parts if parts is None else parts:
        if name not in plan.parts:
            raise ConfigError(f"no part {name!r} in the proof, there is {', '.join(plan.parts)}")
        for cell in _cells_of_part(plan.parts[name]):
            found[f"{cell.scene}/{cell.name}"] = cell
    return found


def _cells_of_part(part: PartParams) -> Iterator[Cell]:
    for scene in part.scenes:
        for seed in range(part.seeds):
            for schedule in part.schedules:
                for avatar, columns in part.cells.items():
                    for motion in columns:
                        yield Cell(scene, avatar, motion, schedule, seed)


def warmup_of(cell: Cell, plan: ProofParams) -> str:
    """The name of the warm-up that a cell goes on from."""
    return f"{cell.avatar}-{plan.columns[cell.motion].observations}-{cell.fit}"


def seconds_of(
    plan: ProofParams,
    costs: CostParams,
    cells: Iterable[Cell],
    iterations: Mapping[str, tuple[int, int]],
) -> float:
    """What cells will cost: seconds of one core, their scenes and warm-ups once.

    Args:
        plan: that they are of.
        costs: what was measured.
        cells: those to be fitted.
        iterations: of each schedule, as `iterations_of` reads them.
    """
    seconds = 0.0
    measured = iterations[costs.schedule][1]
    begun: set[tuple[str, str]] = set()  # scenes and warm-ups
    for cell in cells:
        warm, whole = iterations[cell.schedule]
        fits = costs.fits[cell.avatar]
        warmup = fits[FLOOR] * warm / measured
        seconds += fits[cell.motion] * whole / measured - warmup + costs.scores + costs.starts
        for key, once in (("", costs.scene), (warmup_of(cell, plan), warmup)):
            if (cell.scene, key) not in begun:
                begun.add((cell.scene, key))
                seconds += once
    return seconds


def items_of_scene(plan: ProofParams, scene: str) -> dict[str, Any]:
    """What the stages of one scene's pipeline run over, as `cells.yaml` says it to DVC."""
    cells = [cell for cell in cells_of(plan).values() if cell.scene == scene]
    here = scene not in plan.filmed_at_root
    data = f"experiments/proof/data/{scene}"
    seen = {plan.columns[cell.motion].observations for cell in cells}
    return {
        "scene": scene,
        "observed": f"{data}/preprocess" if here else f"data/preprocess/{scene}",
        "reference": f"{data}/clip/reference" if here else f"data/clip/{scene}/reference",
        "filmed": [scene] if here else [],
        "deblurred": [scene] if here and "deblurred" in seen else [],
        "warmups": {
            warmup_of(cell, plan): {
                "avatar": plan.avatars[cell.avatar],
                "observations": plan.columns[cell.motion].observations,
                "schedule": cell.schedule,
                "fit": cell.fit,
            }
            for cell in cells
        },
        "cells": {
            cell.name: {
                "avatar": plan.avatars[cell.avatar],
                **plan.columns[cell.motion].model_dump(),
                "warmup": warmup_of(cell, plan),
                "schedule": cell.schedule,
                "fit": cell.fit,
            }
            for cell in cells
        },
    }


def iterations_of(path: Path) -> Mapping[str, tuple[int, int]]:
    """Of each schedule: iterations of the warm-up, and of all."""
    schedules = load_params(path, "schedules", dict)
    return {name: (entry["warmup"], entry["fusion"]) for name, entry in schedules.items()}


def files_of(folder: Path) -> dict[Path, bytes]:
    """The files that the plan of a folder's `params.yaml` stands for: pipelines, cells, and a
    parameter file for each schedule and seed.

    Raises:
        ConfigError: as `load_plan`.
    """
    plan = load_plan(folder / "params.yaml")
    snapshots = load_params(folder / "params.yaml", "snapshots", int)
    pipeline = (folder / PIPELINE).read_bytes()
    made = {}
    for scene in plan.scenes:
        made[folder / scene / "dvc.yaml"] = pipeline
        made[folder / scene / "cells.yaml"] = _yaml(items_of_scene(plan, scene))
    for cell in cells_of(plan).values():
        settings = {
            "shared": "../params.yaml", "seed": cell.seed, "schedule": cell.schedule,
            "snapshots": snapshots,
        }  # fmt: skip
        made[folder / "fits" / f"{cell.fit}.yaml"] = _yaml(settings)
    return made


def _yaml(content: Mapping[str, Any]) -> bytes:
    """Sections with one entry a line; JSON is YAML."""
    lines = [f"# {WRITTEN}"]
    for key, value in content.items():
        if isinstance(value, dict) and value:
            lines.append(f"{key}:")
            lines += [f"  {name}: {json.dumps(entry)}" for name, entry in value.items()]
        else:
            lines.append(f"{key}: {json.dumps(value)}")
    return "".join(f"{line}\n" for line in lines).encode()
