"""Stage `learning_curve`: the learning curve of one run, from the avatars kept on the way."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.config.reading import load_params
from deblur_avatar.files import write_json
from deblur_avatar.pipeline.learning_curve import learning_curve


def main(
    scene: str, method: str, observations: Path, reference: Path, warmup: Path, trajectory: Path,
    fusion: Path, metrics: Path, params_file: Path,
) -> None:  # fmt: skip
    """Score all snapshots of one run."""
    seed = load_params(params_file, "seed", int)
    with run.stage("learning_curve", f"{scene}-{method}", seed) as context:
        content = learning_curve(
            Observations.load(observations),
            Reference.load(reference),
            {"warmup": warmup, "trajectory": trajectory, "fusion": fusion},
            context.device,
        )
        write_json(metrics, {"scene": scene, "method": method, **content})


if __name__ == "__main__":
    run.command(main)
