"""Deblur the frames of one scene in the picture, for the baseline that takes them for sharp."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.files import write_json
from deblur_avatar.pipeline.predeblur import PredeblurParams, predeblur


def main(scene: str, observations: Path, out: Path, metrics: Path, params_file: Path) -> None:
    """Turn blurred observations into deblurred ones; `metrics` says by which method."""
    params = load_params(params_file, f"predeblur.{scene}", PredeblurParams)
    seed = load_params(params_file, "seed", int)

    with run.stage("predeblur", scene, seed):
        deblurred, used = predeblur(Observations.load(observations), params)
        deblurred.save(out)
        write_json(metrics, used)


if __name__ == "__main__":
    run.command(main)
