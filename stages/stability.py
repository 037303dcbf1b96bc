"""Stage `stability`: one method in one way to fail, at every severity."""

from pathlib import Path

from deblur_avatar import run
from deblur_avatar.config import MethodParams, ScheduleParams, StartParams, load_params
from deblur_avatar.pipeline.stability import endure, film_of
from deblur_avatar.pipeline.stability_fit import Bench
from deblur_avatar.pipeline.stability_params import ModeParams


def main(mode: str, method: str, scenes: Path, out: Path, params_file: Path) -> None:
    """Write `<out>/measured.json` and the worst picture; `scenes` is what was filmed."""
    seed = load_params(params_file, "seed", int)
    with run.stage("stability", f"{mode}-{method}", seed) as context:
        bench = Bench(
            load_params(params_file, "starts.lean", StartParams),
            load_params(params_file, f"methods.{method}", MethodParams),
            load_params(params_file, "schedules.suite", ScheduleParams),
            validation_stride=load_params(params_file, "validation_stride", int),
            seed=seed,
            device=context.device,
        )
        item = endure(load_params(params_file, f"modes.{mode}", ModeParams), bench, film_of(scenes))
        item.save(out)


if __name__ == "__main__":
    run.command(main)
