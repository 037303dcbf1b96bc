"""Stage `trajectory`: the motion inside each exposure joins the optimisation."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.trajectory import TrajectoryParams, fit_trajectory
from deblur_avatar.training.fitting_stage import fitting_stage
from deblur_avatar.training.params import RecipeParams


def main(
    avatar: str, method: str, observations: Path, warmup: Path, out: Path, metrics: Path,
    cost: Path, params_file: Path,
) -> None:  # fmt: skip
    """Fit the avatar and its motion to the blurred frames."""
    recipe = load_params(params_file, f"avatars.{avatar}", RecipeParams)
    params = load_params(params_file, f"methods.{method}.trajectory", TrajectoryParams)
    inputs = [observations, warmup]
    with fitting_stage("trajectory", out, params_file, [recipe, params], inputs) as stage:
        fitted, motion, checkpoint, measured = fit_trajectory(
            Observations.load(observations),
            Avatar.load(warmup / "avatar"),
            Checkpoint.load(warmup / "checkpoint"),
            recipe, params, stage.schedule, device=stage.device, generator=stage.generator,
            report=stage.report, folder=stage.folder,
        )  # fmt: skip
        fitted.save(out / "avatar")
        motion.save(out / "motion")
        checkpoint.save(out / "checkpoint")
        stage.finish(metrics, cost, measured)


if __name__ == "__main__":
    run.command(main)
