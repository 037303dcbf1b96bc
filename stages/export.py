"""Stage `export`: a fitted run as files that other programs open."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.exports.exporter import FittedRun, sharp_observations
from deblur_avatar.pipeline.export import ExportsParams, export


def main(
    name: str, observations: Path, sharp: Path, fusion: Path, out: Path, params_file: Path
) -> None:
    """Write the files of `exports.<name>` into `<out>`."""
    params = load_params(params_file, f"exports.{name}", ExportsParams)
    with run.stage("export", name, seed=0):  # nothing here is random
        fitted = FittedRun(
            name,
            Avatar.load(fusion / "avatar"),
            Motion.load(fusion / "motion"),
            Observations.load(observations),
            sharp_observations(sharp),
        )
        export(fitted, params, out, f"{params_file}: exports.{name}")


if __name__ == "__main__":
    run.command(main)
