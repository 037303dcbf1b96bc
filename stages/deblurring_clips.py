"""Film what the deblurring network is trained and scored on; nobody in it is in a scene."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.body import Body
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.deblurring_clips import DeblurringClipsParams, make_clips


def main(body: Path, out: Path, params_file: Path) -> None:
    """Write `<out>/training` and `<out>/validation`."""
    params = load_params(params_file, "deblurring_clips", DeblurringClipsParams)
    seed = load_params(params_file, "seed", int)

    with run.stage("deblurring_clips", out.name, seed) as context:
        training, validation = make_clips(params, Body.load(body), context.seed)
        training.save(out / "training")
        validation.save(out / "validation")


if __name__ == "__main__":
    run.command(main)
