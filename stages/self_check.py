"""Say whether a fitted avatar is usable, without ground truth."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.evaluation.findings import tell
from deblur_avatar.files import write_json, write_text
from deblur_avatar.imaging.picture_files import write_picture
from deblur_avatar.pipeline.self_check import self_check
from deblur_avatar.reporting.self_check_pictures import draw_self_check, self_check_page


def main(name: str, observations: Path, fusion: Path, out: Path, metrics: Path) -> None:
    """Write `<out>/self_check.png`, `<out>/index.html` and the findings of one run."""
    with run.stage("self_check", name, seed=0) as context:  # nothing here is random
        seen = Observations.load(observations)
        avatar, motion = Avatar.load(fusion / "avatar"), Motion.load(fusion / "motion")
        checked = self_check(seen, avatar, motion, context.device)
        sheet = draw_self_check(seen, checked.filmed, checked.sides)
        write_picture(out / "self_check.png", sheet)
        write_text(out / "index.html", self_check_page(name, checked.content, sheet))
        write_json(metrics, checked.content)
        tell(name, checked.content)


if __name__ == "__main__":
    run.command(main)
