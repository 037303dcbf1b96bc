"""Settings search: the same small search for every motion, by validation frames.

    python -m benchmarks.settings_search --json FILE --scenes studio=FOLDER striding=FOLDER
        [--avatars plain networks] [--motions agnostic pair paper mad clip]

fits tuning scenes (each an artifact of observations, as the stage `preprocess` leaves it) with each
motion on each avatar, and prints JSON. A search is one fit with the settings of `params.yaml`, one
for every other value of `GRID`, one setting at a time, and one with the value of each setting that
did best over all scenes together: the same values, and as many fits, for every motion. What decides
is PSNR of the training camera's validation frames, which were not fitted; no other view is looked
at. Fits that FILE has are not fitted again.
"""

import argparse
import json
import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any

import torch

from benchmarks.rasterizer import machine
from benchmarks.scene_fits import known_rows
from benchmarks.time_to_quality import PARAMS, fitted, settings_of
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.config.reading import load_params
from deblur_avatar.evaluation.reblur import mean_reblur_psnr
from deblur_avatar.files import write_json
from deblur_avatar.methods import MethodParams
from deblur_avatar.run import chosen_device
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.schedule import ScheduleParams

AVATARS = {"plain": "lean", "networks": "paper"}  # of params.yaml, by the proof's names
MOTIONS = {
    "agnostic": "agnostic", "pair": "no_fusion", "paper": "paper", "mad": "mad", "clip": "lean",
}  # fmt: skip
# Every avatar's and motion's own value is among these.
GRID = {
    "features": (1.0e-3, 5.0e-3, 2.0e-2),  # rate of colours
    "max_growth": (1.25, 1.5, 2.0),  # most Gaussians, times the first count
    "transl": (1.0e-4, 3.0e-4, 1.0e-3),  # rate, metres
    "poses": (1.0e-3, 3.0e-3, 1.0e-2),  # rate, radians
}

Settings = Mapping[str, float]


@dataclass(frozen=True)
class Cell:
    """One fit of a search: what is fitted to which scene, with which settings."""

    scene: str
    avatar: str
    motion: str
    settings: tuple[float, ...]  # in `GRID`'s order

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> "Cell":
        """What a row of a record is of."""
        settings = tuple(row["settings"][name] for name in GRID)
        return cls(row["scene"], row["avatar"], row["motion"], settings)


def own_settings(recipe: RecipeParams, method: MethodParams) -> dict[str, float]:
    """The settings that are searched for, as they are, in `GRID`'s order."""
    motion: Any = method.trajectory.motion
    return {
        "features": recipe.fitting.rates.features,
        "max_growth": recipe.fitting.densify.max_growth,
        "transl": motion.rates.transl,
        "poses": motion.rates.poses,
    }


def with_settings(
    recipe: RecipeParams, method: MethodParams, settings: Settings
) -> tuple[RecipeParams, MethodParams]:
    """The same avatar and motion with other settings."""
    fitting = recipe.fitting
    motion: Any = method.trajectory.motion
    rates = fitting.rates.model_copy(update={"features": settings["features"]})
    densify = fitting.densify.model_copy(update={"max_growth": settings["max_growth"]})
    fitting = fitting.model_copy(update={"rates": rates, "densify": densify})
    steps = {name: settings[name] for name in ("transl", "poses")}
    motion = motion.model_copy(update={"rates": motion.rates.model_copy(update=steps)})
    trajectory = method.trajectory.model_copy(update={"motion": motion})
    return (
        recipe.model_copy(update={"fitting": fitting}),
        method.model_copy(update={"trajectory": trajectory}),
    )


def one_at_a_time(own: Settings) -> Iterator[dict[str, float]]:
    """The own settings, and those that differ from them in one value."""
    yield dict(own)
    for name, values in GRID.items():
        for value in values:
            if value != own[name]:
                yield {**own, name: value}


def best_together(own: Settings, scores: Mapping[tuple[float, ...], float]) -> dict[str, float]:
    """Of each setting the value that did best with all others as they are; its own, if none did.

    Args:
        own: the settings of `params.yaml`.
        scores: by settings in `GRID`'s order, mean over scenes, dB.
    """
    return {
        name: max(
            (own[name], *values), key=lambda value: scores[tuple({**own, name: value}.values())]
        )
        for name, values in GRID.items()
    }


def row_of(cell: Cell, scenes: Mapping[str, Path], schedule_name: str) -> dict[str, Any]:
    """Fit one cell, and score its validation frames."""
    torch.set_num_threads(1)
    settings = dict(zip(GRID, cell.settings, strict=True))
    recipe, method = with_settings(
        *settings_of(MOTIONS[cell.motion], AVATARS[cell.avatar]), settings
    )
    seen = Observations.load(scenes[cell.scene])
    schedule = load_params(PARAMS, f"schedules.{schedule_name}", ScheduleParams)
    last = fitted(seen, recipe, method, schedule, frozenset())[-1]
    model = avatar_from_artifact(last.avatar, seen.body, chosen_device())
    score = mean_reblur_psnr(model, seen, last.motion, seen.validation)
    if score is None:
        raise SystemExit(f"{scenes[cell.scene]}: no frame is set aside for validation")
    return {
        "scene": cell.scene, "avatar": cell.avatar, "motion": cell.motion, "settings": settings,
        "psnr_validation": round(score, 4), "gaussians": len(last.avatar.means),
        "processor_seconds": round(last.processor_seconds, 1),
    }  # fmt: skip


def scenes_of(rows: Sequence[Mapping[str, Any]], avatar: str, motion: str) -> list[str]:
    """The scenes that an avatar with a motion was searched on."""
    return sorted(
        {row["scene"] for row in rows if (row["avatar"], row["motion"]) == (avatar, motion)}
    )


def mean_scores(
    rows: Sequence[Mapping[str, Any]], avatar: str, motion: str
) -> dict[tuple[float, ...], float]:
    """By settings: the mean over an avatar's and a motion's scenes, of settings that all have."""
    scores: dict[tuple[float, ...], dict[str, float]] = {}
    for row in rows:
        cell = Cell.of(row)
        if (cell.avatar, cell.motion) == (avatar, motion):
            scores.setdefault(cell.settings, {})[cell.scene] = row["psnr_validation"]
    count = len(scenes_of(rows, avatar, motion))
    return {key: fmean(one.values()) for key, one in scores.items() if len(one) == count}


def record_of(rows: Sequence[Mapping[str, Any]], schedule_name: str) -> dict[str, Any]:
    """The rows, and for every avatar and motion what its search brought, dB over its scenes."""
    searches = []
    for avatar, motion in sorted({(row["avatar"], row["motion"]) for row in rows}):
        scores = mean_scores(rows, avatar, motion)
        own = own_settings(*settings_of(MOTIONS[motion], AVATARS[avatar]))
        singles = [tuple(settings.values()) for settings in one_at_a_time(own)]
        if not set(singles) <= set(scores):
            continue
        here = scores[singles[0]]
        together = best_together(own, scores)
        found = scores.get(tuple(together.values()))
        searches.append({
            "avatar": avatar, "motion": motion, "scenes": scenes_of(rows, avatar, motion),
            "fits": len(scores), "own": own,
            "psnr_validation": round(here, 4),
            "gain_of": {
                f"{name} {value:g}": round(scores[tuple({**own, name: value}.values())] - here, 4)
                for name, values in GRID.items() for value in values if value != own[name]
            },
            "best_together": together,
            "gain_together": None if found is None else round(found - here, 4),
        })  # fmt: skip
    return {
        "machine": machine(0.0), "schedule": schedule_name, "searches": searches,
        "rows": sorted((dict(row) for row in rows), key=lambda row: str(Cell.of(row))),
    }  # fmt: skip


def wanted(arguments: argparse.Namespace, rows: Sequence[Mapping[str, Any]]) -> list[Cell]:
    """The cells that can be fitted now: single changes first, then the best of them together."""
    cells = []
    for avatar, motion in product(arguments.avatars, arguments.motions):
        own = own_settings(*settings_of(MOTIONS[motion], AVATARS[avatar]))
        settings = [tuple(one.values()) for one in one_at_a_time(own)]
        scores = mean_scores(rows, avatar, motion)
        if set(settings) <= set(scores):
            settings.append(tuple(best_together(own, scores).values()))
        cells += [
            Cell(scene, avatar, motion, one) for scene in arguments.scenes for one in settings
        ]
    done = {Cell.of(row) for row in rows}
    return [cell for cell in cells if cell not in done]


def main(arguments: argparse.Namespace) -> None:
    """Fit, print, write."""
    path: Path | None = arguments.json
    rows = known_rows(path, arguments.schedule)
    fit = partial(row_of, scenes=arguments.scenes, schedule_name=arguments.schedule)
    with multiprocessing.get_context("spawn").Pool(arguments.at_once) as pool:
        while cells := wanted(arguments, rows):
            for row in pool.imap_unordered(fit, cells):
                rows.append(row)
                print(json.dumps(row), flush=True)
                if path:
                    write_json(path, record_of(rows, arguments.schedule))
    print(json.dumps(record_of(rows, arguments.schedule)["searches"], indent=1))


def _arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the record to this file, or go on with it")
    parser.add_argument(
        "--scenes", nargs="+", required=True, metavar="NAME=FOLDER", help="observations"
    )  # fmt: skip
    parser.add_argument("--avatars", nargs="+", choices=AVATARS, default=list(AVATARS))
    parser.add_argument("--motions", nargs="+", choices=MOTIONS, default=list(MOTIONS))
    parser.add_argument("--schedule", default="short", help="of params.yaml")
    parser.add_argument("--at-once", type=int, default=2, help="fits at a time")
    arguments = parser.parse_args(words)
    arguments.scenes = {
        name: Path(folder) for name, _, folder in (word.partition("=") for word in arguments.scenes)
    }
    return arguments


if __name__ == "__main__":
    main(_arguments())
