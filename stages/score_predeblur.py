"""Score what deblurring in the picture made of one scene's frames."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.files import write_json
from deblur_avatar.pipeline.score_predeblur import score_predeblur


def main(scene: str, observations: Path, deblurred: Path, sharp: Path, metrics: Path) -> None:
    """Compare blurred and deblurred observations with the sharp ones, where there are any."""
    with run.stage("score_predeblur", scene, seed=0):  # nothing here is drawn at random
        blurred, made = Observations.load(observations), Observations.load(deblurred)
        write_json(metrics, score_predeblur(made, blurred, sharp))


if __name__ == "__main__":
    run.command(main)
