"""Stage `stability`: one method in one way to fail, at every severity."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from benchmarks.stress.fit import FitSetup
from benchmarks.stress.params import ModeParams
from benchmarks.stress.suite import run_mode, scenes_in
from deblur_avatar import run
from deblur_avatar.config.reading import load_params


def main(mode: str, method: str, scenes: Path, out: Path, params_file: Path) -> None:
    """Write `<out>/measured.json` and the worst picture; `scenes` is what was filmed."""
    seed = load_params(params_file, "seed", int)
    with run.stage("stability", f"{mode}-{method}", seed) as context:
        setup = FitSetup.of(method, params_file, seed, context.device)
        params = load_params(params_file, f"modes.{mode}", ModeParams)
        item = run_mode(params, setup, scenes_in(scenes))
        item.save(out)


if __name__ == "__main__":
    run.command(main)
