"""Stage `fusion`: sharp and averaged renders are blended by where the body moved."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.motion.kinds import AnyMotionParams
from deblur_avatar.pipeline.fusion import FusionParams, fuse
from deblur_avatar.training.fitting_stage import fitting_stage
from deblur_avatar.training.params import RecipeParams


def main(
    avatar: str, method: str, observations: Path, trajectory: Path, out: Path, metrics: Path,
    cost: Path, params_file: Path,
) -> None:  # fmt: skip
    """Finish the avatar and its motion."""
    recipe = load_params(params_file, f"avatars.{avatar}", RecipeParams)
    moves = load_params(params_file, f"methods.{method}.trajectory.motion", AnyMotionParams)
    params = load_params(params_file, f"methods.{method}.fusion", FusionParams)
    settings, inputs = [recipe, moves, params], [observations, trajectory]
    with fitting_stage("fusion", out, params_file, settings, inputs) as stage:
        fitted, motion, measured = fuse(
            Observations.load(observations), Avatar.load(trajectory / "avatar"),
            Motion.load(trajectory / "motion"), Checkpoint.load(trajectory / "checkpoint"),
            recipe, moves, params, stage.schedule, device=stage.device, generator=stage.generator,
            report=stage.report, folder=stage.folder,
        )  # fmt: skip
        fitted.save(out / "avatar")
        motion.save(out / "motion")
        stage.finish(metrics, cost, measured)


if __name__ == "__main__":
    run.command(main)
