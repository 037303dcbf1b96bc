"""Stage `trajectory`: the motion inside each exposure joins the optimisation."""

from pathlib import Path

from deblur_avatar import run
from deblur_avatar.artifacts import Avatar, Checkpoint, Observations
from deblur_avatar.config import ScheduleParams, StartParams, TrajectoryParams, load_params
from deblur_avatar.pipeline.trajectory import fit_trajectory


def main(
    start: str, method: str, observations: Path, warmup: Path, out: Path, metrics: Path,
    params_file: Path,
) -> None:  # fmt: skip
    """Fit the avatar and its motion to the blurred frames."""
    schedule_name = load_params(params_file, "schedule", str)
    schedule = load_params(params_file, f"schedules.{schedule_name}", ScheduleParams)
    with run.stage("trajectory", out.name, load_params(params_file, "seed", int)) as context:
        avatar, motion, checkpoint, cost = fit_trajectory(
            Observations.load(observations),
            Avatar.load(warmup / "avatar"),
            Checkpoint.load(warmup / "checkpoint"),
            load_params(params_file, f"starts.{start}", StartParams),
            load_params(params_file, f"methods.{method}.trajectory", TrajectoryParams),
            schedule,
            device=context.device,
            generator=context.generator,
            report=run.fitting_progress(f"trajectory {out.name}", schedule.trajectory),
        )
        avatar.save(out / "avatar")
        motion.save(out / "motion")
        checkpoint.save(out / "checkpoint")
        run.write_json(metrics, cost | {"peak_memory_mb": run.peak_memory_mb()})


if __name__ == "__main__":
    run.command(main)
