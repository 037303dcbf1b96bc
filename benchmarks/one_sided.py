"""One-sided clips: what keeping near the body and filling in unseen colours bring, over seeds.

    python -m benchmarks.one_sided --json FILE [--variants lean filled one_sided] [--seeds 0 1 2]

films the proof's tuning scenes with hardly a turn, so that 28 to 45 % of the body are never seen,
fits each with `lean`'s recipe, with `one_sided`'s, and with that one's colours alone (`filled`: no
penalty on what stands off the body), and scores them from four cameras around the person: PSNR of
all pixels and over the surface that the training camera saw, FLIP, the share of a turntable's light
more than 5 cm off the body, and PSNR of the training camera's frames set aside. The summary has
means over scenes and seeds, and of every variant what it gains over `lean` in the same scene with
the same seed, with the standard error of that mean. Fits that FILE has are not fitted again. One
takes some 40 s on two idle cores, with its scores.
"""

import argparse
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

from benchmarks.scene_fits import PROOF, SIZE, complete_record, parser_of
from benchmarks.time_to_quality import (
    filmed_scene,
    fitted,
    novel_views,
    scores_of_views,
    settings_of,
)
from deblur_avatar import run
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.evaluation.reblur import mean_reblur_psnr
from deblur_avatar.evaluation.surface_quality import surface_quality
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.schedule import ScheduleParams

TURNS = {"striding": 0.2, "jumping": -0.1, "dancing": 0.3}  # of tuning scenes, by the whole clip
VARIANTS = ("lean", "filled", "one_sided")
SCORES = ("psnr", "psnr_seen", "flip", "psnr_validation", "fur_share")
KEYS = ("scene", "variant", "seed")


def recipe_of(variant: str) -> RecipeParams:
    """What is fitted: a recipe of `params.yaml`, or `one_sided`'s without its penalty."""
    recipe, _ = settings_of("lean", "lean" if variant == "lean" else "one_sided")
    if variant != "filled":
        return recipe
    fitting: Any = recipe.fitting
    free = fitting.regularisers.model_copy(update={"near_body": 0.0})
    return recipe.model_copy(update={"fitting": fitting.model_copy(update={"regularisers": free})})


def row_of(
    scene: str, variant: str, seed: int, folder: Path, schedule: ScheduleParams
) -> dict[str, Any]:
    """Fit one variant to one scene, and look at it from all sides."""
    changes = {"turns": TURNS[scene]}
    observations, reference = filmed_scene(PROOF, scene, changes, folder / scene, SIZE)
    _, method = settings_of("lean")
    last = fitted(observations, recipe_of(variant), method, schedule, frozenset(), seed=seed)[-1]
    model = avatar_from_artifact(last.avatar, observations.body, run.chosen_device())
    views = novel_views(observations, reference)
    scores = scores_of_views(views, observations, reference, last)
    return {
        "scene": scene, "variant": variant, "seed": seed, "views": len(views),
        **{name: scores[name] for name in ("psnr", "psnr_seen", "flip")},
        "psnr_validation": mean_reblur_psnr(
            model, observations, last.motion, observations.validation
        ),
        "fur_share": surface_quality(model, observations, last.motion)["fur_share"],
        "seconds": last.seconds,
    }  # fmt: skip


def summary_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """By variant: means, and what each score gains over `lean`'s, scene by scene, seed by seed."""
    found = {tuple(row[key] for key in KEYS): row for row in rows}
    summary = {}
    for variant in sorted({row["variant"] for row in rows}):
        own = [row for row in rows if row["variant"] == variant]
        means = {name: fmean(row[name] for row in own) for name in SCORES}
        summary[variant] = {"fits": len(own), **means}
        pairs = [
            (row, found[row["scene"], "lean", row["seed"]])
            for row in own
            if (row["scene"], "lean", row["seed"]) in found
        ]
        if variant == "lean" or len(pairs) < 2:
            continue
        for name in SCORES:
            gains = [row[name] - other[name] for row, other in pairs]
            summary[variant][f"{name}_gain"] = fmean(gains)
            summary[variant][f"{name}_gain_error"] = stdev(gains) / len(gains) ** 0.5
    return summary


def main(arguments: argparse.Namespace) -> None:
    """Fit, print, write."""
    every = product(arguments.seeds, arguments.scenes, arguments.variants)
    wanted = ((scene, variant, seed) for seed, scene, variant in every)
    complete_record(arguments, KEYS, wanted, row_of, summary_of, turns=TURNS)


def _arguments(words: Sequence[str] | None = None) -> argparse.Namespace:
    parser = parser_of(__doc__.splitlines()[0], tuple(TURNS), (0, 1, 2), "data/one_sided")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    return parser.parse_args(words)


if __name__ == "__main__":
    main(_arguments())
