"""Say whether a scene is fit for training, before any training."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.config.reading import load_params
from deblur_avatar.evaluation.findings import tell
from deblur_avatar.files import read_json, write_json, write_text
from deblur_avatar.imaging.picture_files import write_picture
from deblur_avatar.pipeline.check import (
    CheckParams,
    check_scene,
    refuse_failed,
)
from deblur_avatar.reporting.check_pictures import check_page, draw_check


def main(
    scene: str, observations: Path, fit: Path, out: Path, metrics: Path, params_file: Path
) -> None:
    """Write `<out>/check.png`, `<out>/index.html` and the findings; `fit` are metrics."""
    params = load_params(params_file, "check", CheckParams)
    with run.stage("check", scene, seed=0):  # nothing here is drawn at random
        seen = Observations.load(observations)
        content = check_scene(seen, read_json(fit))
        sheet = draw_check(seen)
        write_picture(out / "check.png", sheet)
        write_text(out / "index.html", check_page(scene, content, sheet))
        write_json(metrics, content)
        tell(scene, content)
        refuse_failed(scene, content, params)


if __name__ == "__main__":
    run.command(main)
