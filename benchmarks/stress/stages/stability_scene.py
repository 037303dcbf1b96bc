"""Stage `stability_scene`: one small scene of the stability suite, and what its ceilings are."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from benchmarks.stress.fit import FitSetup
from benchmarks.stress.params import StabilitySceneParams
from benchmarks.stress.scene import film_scene, measure_ceilings
from deblur_avatar import run
from deblur_avatar.config.reading import load_params
from deblur_avatar.files import write_json


def main(scene: str, out: Path, params_file: Path) -> None:
    """Write `<out>/clip`, the truth `<out>/reference` and `<out>/ceiling.json`."""
    params = load_params(params_file, f"scenes.{scene}", StabilitySceneParams)
    seed = load_params(params_file, "seed", int)
    with run.stage("stability_scene", scene, seed) as context:
        body, clip, reference = film_scene(params, context.generator)
        setup = FitSetup.of("ceiling", params_file, seed, context.device)
        ceilings = measure_ceilings(clip, reference, body, setup, params.networks)
        clip.save(out / "clip")
        reference.save(out / "reference")
        write_json(out / "ceiling.json", ceilings)


if __name__ == "__main__":
    run.command(main)
