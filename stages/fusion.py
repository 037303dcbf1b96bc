"""Stage `fusion`: sharp and averaged renders are blended by where the body moved."""

from pathlib import Path

from deblur_avatar import run
from deblur_avatar.artifacts import Avatar, Checkpoint, Motion, Observations
from deblur_avatar.config import FusionParams, ScheduleParams, StartParams, load_params
from deblur_avatar.pipeline.fusion import fuse


def main(
    start: str, method: str, observations: Path, trajectory: Path, out: Path, metrics: Path,
    params_file: Path,
) -> None:  # fmt: skip
    """Finish the avatar and its motion."""
    schedule_name = load_params(params_file, "schedule", str)
    schedule = load_params(params_file, f"schedules.{schedule_name}", ScheduleParams)
    with run.stage("fusion", out.name, load_params(params_file, "seed", int)) as context:
        avatar, motion, cost = fuse(
            Observations.load(observations),
            Avatar.load(trajectory / "avatar"),
            Motion.load(trajectory / "motion"),
            Checkpoint.load(trajectory / "checkpoint"),
            load_params(params_file, f"starts.{start}", StartParams),
            load_params(params_file, f"methods.{method}.fusion", FusionParams),
            schedule,
            device=context.device,
            generator=context.generator,
            report=run.fitting_progress(f"fusion {out.name}", schedule.fusion),
        )
        avatar.save(out / "avatar")
        motion.save(out / "motion")
        run.write_json(metrics, cost | {"peak_memory_mb": run.peak_memory_mb()})


if __name__ == "__main__":
    run.command(main)
