"""Stage `warmup`: a sharp-frame avatar, shared by every method that starts like this."""

from pathlib import Path

from deblur_avatar import run
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.warmup import warm_up
from deblur_avatar.training.fitting_stage import fitting_stage
from deblur_avatar.training.params import StartParams


def main(
    start: str, observations: Path, out: Path, metrics: Path, cost: Path, params_file: Path
) -> None:
    """Fit an avatar to the frames as if they were sharp."""
    params = load_params(params_file, f"starts.{start}", StartParams)
    with fitting_stage("warmup", out, params_file, [params], [observations]) as stage:
        avatar, checkpoint, measured = warm_up(
            Observations.load(observations),
            params,
            stage.schedule,
            device=stage.device,
            generator=stage.generator,
            report=stage.report,
            folder=stage.folder,
        )
        avatar.save(out / "avatar")
        checkpoint.save(out / "checkpoint")
        stage.finish(metrics, cost, measured)


if __name__ == "__main__":
    run.command(main)
