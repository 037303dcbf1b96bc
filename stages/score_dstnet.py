"""Score the deblurring network on clips of persons whom it was not trained on."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.deblurring_clips import DeblurringClips
from deblur_avatar.config.reading import load_params
from deblur_avatar.files import write_json
from deblur_avatar.imaging.picture_files import write_picture
from deblur_avatar.pipeline.score_dstnet import ScoreDstnetParams, score_deblurrers


def main(clips: Path, metrics: Path, strip: Path, params_file: Path) -> None:
    """Compare it with blurred frames and with other ways of deblurring."""
    params = load_params(params_file, "score_dstnet", ScoreDstnetParams)
    with run.stage("score_dstnet", clips.name, seed=0):  # nothing here is drawn at random
        scored = score_deblurrers(DeblurringClips.load(clips), params)
        write_json(metrics, scored.scores)
        write_picture(strip, scored.strip.numpy())


if __name__ == "__main__":
    run.command(main)
