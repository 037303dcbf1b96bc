"""Guessed shutters: what believing a wrong one costs, and what estimating it wins back.

    python -m benchmarks.guessed_shutter --json FILE [--scenes striding] [--factors 0.5 1 2]

films the proof's tuning scenes, says of each that its shutter was open for some factor of the
truth, and fits `lean` with the avatar of new clips twice: believing that, and taking it for a first
guess (docs/decisions/0063). Scores are from four cameras around the person: PSNR of all pixels and
over the surface that the training camera saw, FLIP; `shutter_share` is the shutter that was found
over the true one. The summary has means over scenes. Fits that FILE has are not fitted again. One
takes some 40 s on two idle cores, with its scores.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any

import torch

from benchmarks.rasterizer import machine
from benchmarks.settings_search import known_rows
from benchmarks.time_to_quality import (
    PARAMS,
    filmed_scene,
    fitted,
    novel_views,
    scores_of_views,
    settings_of,
)
from deblur_avatar import run
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.sources.monocular import GUESSED_EXPOSURE_STD
from deblur_avatar.training.schedule import ScheduleParams

PROOF = Path("experiments/proof/params.yaml")
SCENES = ("striding", "jumping", "dancing")  # tuning scenes
WAYS = ("believed", "estimated")
SCORES = ("psnr", "psnr_seen", "flip", "shutter_share")
SIZE = 192  # pixels


def told(observations: Observations, way: str, factor: float) -> Observations:
    """The same frames, said to have been exposed for some factor of the truth."""
    assert observations.exposure is not None
    std = GUESSED_EXPOSURE_STD if way == "estimated" else None
    return replace(observations, exposure=factor * observations.exposure, exposure_std=std)


def row_of(
    scene: str, way: str, factor: float, seed: int, folder: Path, schedule: ScheduleParams
) -> dict[str, Any]:
    """Fit one scene with one shutter told in one way, and look at it from all sides."""
    observations, reference = filmed_scene(PROOF, scene, {}, folder / scene, SIZE)
    seen, true = told(observations, way, factor), observations.exposure
    assert seen.exposure is not None
    assert true is not None
    recipe, method = settings_of("lean", "one_sided")
    last = fitted(seen, recipe, method, schedule, frozenset(), seed=seed)[-1]
    views = novel_views(seen, reference)
    scores = scores_of_views(views, seen, reference, last)
    return {
        "scene": scene, "way": way, "factor": factor, "seed": seed, "views": len(views),
        **{name: scores[name] for name in ("psnr", "psnr_seen", "flip")},
        "shutter_share": (last.motion.shutter or seen.exposure) / true,
        "seconds": last.seconds,
    }  # fmt: skip


def key_of(row: Mapping[str, Any]) -> tuple[str, str, float, int]:
    """What tells rows apart."""
    return row["scene"], row["way"], row["factor"], row["seed"]


def summary_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Means over scenes and seeds, by way and factor."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(f"{row['way']}, {row['factor']:g} times", []).append(row)
    return {
        name: {"fits": len(own), **{score: fmean(row[score] for row in own) for score in SCORES}}
        for name, own in sorted(groups.items())
    }


def main(arguments: argparse.Namespace) -> None:
    """Fit, print, write."""
    torch.set_num_threads(1)
    path: Path | None = arguments.json
    schedule = load_params(PARAMS, f"schedules.{arguments.schedule}", ScheduleParams)
    rows = known_rows(path, arguments.schedule)
    done = {key_of(row) for row in rows}
    for wanted in product(arguments.scenes, WAYS, arguments.factors, arguments.seeds):
        if wanted in done:
            continue
        rows.append(row_of(*wanted, arguments.folder, schedule))
        print(json.dumps(rows[-1]), flush=True)
        if path:
            run.write_json(path, record_of(rows, arguments.schedule))
    print(json.dumps(summary_of(rows), indent=1))


def record_of(rows: Sequence[Mapping[str, Any]], schedule: str) -> dict[str, Any]:
    """Where, how long, what each fit scored, and what that says."""
    return {
        "machine": machine(0.0), "schedule": schedule, "summary": summary_of(rows),
        "rows": sorted((dict(row) for row in rows), key=key_of),
    }  # fmt: skip


def _arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the record to this file, or go on with it")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument(
        "--factors", type=float, nargs="+", default=[0.5, 1.0, 2.0], help="told over true"
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="of the fits' draws")
    parser.add_argument("--schedule", default="medium", help="of params.yaml")
    parser.add_argument(
        "--folder", type=Path, default=Path("data/guessed_shutter"), help="where films are kept"
    )
    return parser.parse_args(words)


if __name__ == "__main__":
    main(_arguments())
