"""Still scene: what a model of motion costs where nothing moves, in processor seconds.

    python -m benchmarks.still_scene [--scene still|turn_1] [--rounds 8] [--disturbed]
        [--scenes FOLDER] [--json FILE]

fits a scene of the stability suite by `agnostic` and by `lean`, in turns, and prints JSON: for each
method the processor seconds of every fit (warm-up to fusion, all threads), the shortest and the
median, Gaussians, instants of an exposure, and PSNR of the training camera's validation frames; and
how many times as long `lean` takes. The ratio of the shortest is what the suite judges: at most
1.15. `turn_1` moves, but is sharp. Poses are exact unless `--disturbed`.

Processor seconds do not count what else runs, but caches are shared: turns are alike for both.
Filming takes longer than a fit; `--scenes` is a folder where films are kept.
"""

import argparse
import statistics
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from benchmarks.rasterizer import machine
from benchmarks.record import print_record
from benchmarks.stress.fit import FitSetup, Fitted, fit_method
from benchmarks.stress.input import prepare
from benchmarks.stress.params import StabilitySceneParams
from benchmarks.stress.scene import film_scene
from deblur_avatar import run
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.bodies.capsule import capsule_body
from deblur_avatar.config.reading import load_params
from deblur_avatar.evaluation.reblur import mean_reblur_psnr

PARAMETERS = Path("stability/params.yaml")
METHODS = ("agnostic", "lean")
SEED = 0


def filmed(scene: str, folder: Path | None) -> Clip:
    """A scene of the suite, taken from a folder or kept there, if one is given."""
    kept = None if folder is None else folder / scene
    if kept is not None and kept.is_dir():
        return Clip.load(kept)
    params = load_params(PARAMETERS, f"scenes.{scene}", StabilitySceneParams)
    derived = run.derive_seed(SEED, "stability_scene", scene)
    clip = film_scene(params, torch.Generator().manual_seed(derived))[1]
    if kept is not None:
        clip.save(kept)
    return clip


def seen(clip: Clip, setup: FitSetup, *, disturbed: bool) -> Observations:
    """What is fitted of a clip, with exact poses unless these are to be disturbed."""
    damage = {} if disturbed else {"exact_poses": 0.0}
    height, stride = setup.schedule.image_height, setup.validation_stride
    return prepare(clip, capsule_body(), damage, height, stride, setup.seed).blurred


def in_turns(
    observations: Observations, setups: Mapping[str, FitSetup], rounds: int
) -> dict[str, list[Fitted]]:
    """As many fits by each method; every other round begins with the last."""
    fits: dict[str, list[Fitted]] = {name: [] for name in setups}
    for draw in range(rounds):
        for name in list(setups)[:: -1 if draw % 2 else 1]:
            fitted = fit_method(observations, setups[name], setups[name].plain, draw=draw)
            fits[name].append(fitted)
    return fits


def summary(observations: Observations, fits: Mapping[str, list[Fitted]]) -> dict[str, Any]:
    """What each method took and made, and how many times as long the last takes as the first."""
    rows = {name: _row(observations, own) for name, own in fits.items()}
    first, last = (rows[name] for name in METHODS)
    ratios = {
        f"ratio_of_{which}": round(last[f"{which}_s"] / first[f"{which}_s"], 3)
        for which in ("shortest", "median")
    }
    return {**ratios, **rows}


def _row(observations: Observations, fits: list[Fitted]) -> dict[str, Any]:
    seconds = [fitted.processor_s for fitted in fits]
    return {
        "shortest_s": round(min(seconds), 3),
        "median_s": round(statistics.median(seconds), 3),
        "processor_s": [round(value, 3) for value in seconds],
        "gaussians": [len(fitted.avatar.means) for fitted in fits],
        "virtual_poses": [round(float(f.motion.num_samples.float().mean()), 2) for f in fits],
        "psnr_validation": [_validation(observations, fitted) for fitted in fits],
    }


def _validation(observations: Observations, fitted: Fitted) -> float:
    model = avatar_from_artifact(fitted.avatar, observations.body, torch.device("cpu"))
    score = mean_reblur_psnr(model, observations, fitted.motion, observations.validation)
    assert score is not None
    return round(score, 3)


def main() -> None:
    """Film, fit in turns, print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scene", default="still")
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--disturbed", action="store_true", help="poses as a detector gives them")
    parser.add_argument("--scenes", type=Path, help="folder where films are kept")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    cpu = torch.device("cpu")
    setups = {name: FitSetup.of(name, PARAMETERS, SEED, cpu) for name in METHODS}
    where = {"scene": options.scene, "disturbed": options.disturbed, "machine": machine(0.0)}
    clip = filmed(options.scene, options.scenes)
    observations = seen(clip, setups["lean"], disturbed=options.disturbed)
    fits = in_turns(observations, setups, options.rounds)
    print_record(where | summary(observations, fits), options.json)


if __name__ == "__main__":
    main()
