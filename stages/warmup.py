"""Stage `warmup`: a sharp-frame avatar, shared by every method that goes on from it."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.warmup import warm_up
from deblur_avatar.training.fitting_stage import fitting_stage
from deblur_avatar.training.params import RecipeParams


def main(
    avatar: str, observations: Path, out: Path, metrics: Path, cost: Path, params_file: Path
) -> None:
    """Fit an avatar to the frames as if they were sharp."""
    recipe = load_params(params_file, f"avatars.{avatar}", RecipeParams)
    with fitting_stage("warmup", out, params_file, [recipe], [observations]) as stage:
        fitted, checkpoint, measured = warm_up(
            Observations.load(observations),
            recipe,
            stage.schedule,
            device=stage.device,
            generator=stage.generator,
            report=stage.report,
            folder=stage.folder,
        )
        fitted.save(out / "avatar")
        checkpoint.save(out / "checkpoint")
        stage.finish(metrics, cost, measured)


if __name__ == "__main__":
    run.command(main)
