"""Bake one body into the container that every stage reads."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.body import BodyParams, build_body


def main(name: str, out: Path, params_file: Path) -> None:
    """Build the body `bodies.<name>` and write it to `out`."""
    params = load_params(params_file, f"bodies.{name}", BodyParams)
    seed = load_params(params_file, "seed", int)

    with run.stage("body", name, seed):
        build_body(params).save(out)


if __name__ == "__main__":
    run.command(main)
