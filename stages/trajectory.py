"""Stage `trajectory`: the motion inside each exposure joins the optimisation."""

from pathlib import Path

from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.trajectory import TrajectoryParams, fit_trajectory
from deblur_avatar.training.fitting_stage import fitting_stage
from deblur_avatar.training.params import StartParams


def main(
    start: str, method: str, observations: Path, warmup: Path, out: Path, metrics: Path,
    cost: Path, params_file: Path,
) -> None:  # fmt: skip
    """Fit the avatar and its motion to the blurred frames."""
    begun = load_params(params_file, f"starts.{start}", StartParams)
    params = load_params(params_file, f"methods.{method}.trajectory", TrajectoryParams)
    inputs = [observations, warmup]
    with fitting_stage("trajectory", out, params_file, [begun, params], inputs) as stage:
        avatar, motion, checkpoint, measured = fit_trajectory(
            Observations.load(observations),
            Avatar.load(warmup / "avatar"),
            Checkpoint.load(warmup / "checkpoint"),
            begun, params, stage.schedule, device=stage.device, generator=stage.generator,
            report=stage.report, folder=stage.folder,
        )  # fmt: skip
        avatar.save(out / "avatar")
        motion.save(out / "motion")
        checkpoint.save(out / "checkpoint")
        stage.finish(metrics, cost, measured)


if __name__ == "__main__":
    run.command(main)
