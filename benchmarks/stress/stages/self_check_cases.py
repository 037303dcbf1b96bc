"""Stage `self_check_cases`: avatars known to be good or damaged, and what the self-check says."""

from functools import cache
from pathlib import Path

import deblur_avatar.loading  # noqa: F401

# isort: split
import torch

from benchmarks.stress.fit import FitSetup
from benchmarks.stress.params import SelfCheckParams, StabilitySceneParams
from benchmarks.stress.scene import film_scene
from benchmarks.stress.self_check_cases import cases_of, confusion, judge_case
from deblur_avatar import run
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.config.reading import load_params
from deblur_avatar.files import write_json


def main(metrics: Path, params_file: Path) -> None:
    """Film the scenes that cases are of, and write the confusion table with all its cases."""
    params = load_params(params_file, "self_check", SelfCheckParams)
    seed = load_params(params_file, "seed", int)
    with run.stage("self_check_cases", "all", seed) as context:
        setups = {
            method: FitSetup.of(method, params_file, seed, context.device)
            for method in params.methods
        }

        @cache
        def load_scene(name: str) -> tuple[Clip, Reference]:
            scene = load_params(params_file, f"scenes.{name}", StabilitySceneParams)
            derived = run.derive_seed(seed, "stability_scene", name)
            generator = torch.Generator().manual_seed(derived)
            return film_scene(scene, generator)[1:]

        cases = run.progress(list(cases_of(params)), "self-checks")
        rows = [judge_case(case, setups[case.method], load_scene) for case in cases]
        write_json(metrics, confusion(rows))


if __name__ == "__main__":
    run.command(main)
