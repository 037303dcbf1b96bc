"""Stage `stability`: one method in one way to fail, at every severity."""

from pathlib import Path

from benchmarks.stress.fit import FitSetup
from benchmarks.stress.params import ModeParams
from benchmarks.stress.suite import run_mode, scenes_in
from deblur_avatar import run
from deblur_avatar.config.reading import load_params
from deblur_avatar.parameters import MethodParams
from deblur_avatar.training.params import RecipeParams
from deblur_avatar.training.schedule import ScheduleParams


def main(mode: str, method: str, scenes: Path, out: Path, params_file: Path) -> None:
    """Write `<out>/measured.json` and the worst picture; `scenes` is what was filmed."""
    seed = load_params(params_file, "seed", int)
    with run.stage("stability", f"{mode}-{method}", seed) as context:
        setup = FitSetup(
            load_params(params_file, "avatars.lean", RecipeParams),
            load_params(params_file, f"methods.{method}", MethodParams),
            load_params(params_file, "schedules.suite", ScheduleParams),
            validation_stride=load_params(params_file, "validation_stride", int),
            seed=seed,
            device=context.device,
        )
        item = run_mode(
            load_params(params_file, f"modes.{mode}", ModeParams), setup, scenes_in(scenes)
        )
        item.save(out)


if __name__ == "__main__":
    run.command(main)
