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
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any

from benchmarks.scene_fits import PROOF, SIZE, complete_record, parser_of
from benchmarks.time_to_quality import (
    filmed_scene,
    fitted,
    novel_views,
    scores_of_views,
    settings_of,
)
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.imaging.exposure import GUESS_STD
from deblur_avatar.training.schedule import ScheduleParams

SCENES = ("striding", "jumping", "dancing")  # tuning scenes
WAYS = ("believed", "estimated")
SCORES = ("psnr", "psnr_seen", "flip", "shutter_share")
KEYS = ("scene", "way", "factor", "seed")


def told(observations: Observations, way: str, factor: float) -> Observations:
    """The same frames, said to have been exposed for some factor of the truth."""
    assert observations.exposure is not None
    std = GUESS_STD if way == "estimated" else None
    return replace(observations, exposure=factor * observations.exposure, exposure_std=std)


def row_of(
    scene: str, way: str, factor: float, seed: int, folder: Path, schedule: ScheduleParams
) -> dict[str, Any]:
    """Fit one scene with one shutter told in one way, and look at it from all sides."""
    observations, reference = filmed_scene(PROOF, scene, {}, folder / scene, SIZE)
    seen, true = told(observations, way, factor), observations.exposure
    recipe, method = settings_of("lean", "one_sided")
    last = fitted(seen, recipe, method, schedule, frozenset(), seed=seed)[-1]
    views = novel_views(seen, reference)
    scores = scores_of_views(views, seen, reference, last)
    found = last.motion.exposure(seen.exposure)
    assert found is not None
    assert true is not None
    return {
        "scene": scene, "way": way, "factor": factor, "seed": seed, "views": len(views),
        **{name: scores[name] for name in ("psnr", "psnr_seen", "flip")},
        "shutter_share": found / true,
        "seconds": last.seconds,
    }  # fmt: skip


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
    wanted = product(arguments.scenes, WAYS, arguments.factors, arguments.seeds)
    complete_record(arguments, KEYS, wanted, row_of, summary_of)


def _arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = parser_of(__doc__.splitlines()[0], SCENES, (0,), "data/guessed_shutter")
    parser.add_argument(
        "--factors", type=float, nargs="+", default=[0.5, 1.0, 2.0], help="told over true"
    )
    return parser.parse_args(words)


if __name__ == "__main__":
    main(_arguments())
