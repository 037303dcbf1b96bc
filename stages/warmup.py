"""Stage `warmup`: a sharp-frame avatar, shared by every method that starts like this."""

from pathlib import Path

from deblur_avatar import run
from deblur_avatar.artifacts import Observations
from deblur_avatar.config import ScheduleParams, StartParams, load_params
from deblur_avatar.pipeline.warmup import warm_up


def main(start: str, observations: Path, out: Path, metrics: Path, params_file: Path) -> None:
    """Fit an avatar to the frames as if they were sharp."""
    schedule_name = load_params(params_file, "schedule", str)
    schedule = load_params(params_file, f"schedules.{schedule_name}", ScheduleParams)
    params = load_params(params_file, f"starts.{start}", StartParams)
    with run.stage("warmup", out.name, load_params(params_file, "seed", int)) as context:
        avatar, checkpoint, cost = warm_up(
            Observations.load(observations),
            params,
            schedule,
            device=context.device,
            generator=context.generator,
            report=run.fitting_progress(f"warmup {out.name}", schedule.warmup),
        )
        avatar.save(out / "avatar")
        checkpoint.save(out / "checkpoint")
        run.write_json(metrics, cost | {"peak_memory_mb": run.peak_memory_mb()})


if __name__ == "__main__":
    run.command(main)
