"""Score a clip's made blur and the interpolation behind it."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.clip import BlurryClip, Clip
from deblur_avatar.config.reading import load_params
from deblur_avatar.files import write_json
from deblur_avatar.pipeline.blur import BlurParams
from deblur_avatar.pipeline.score_blur import score_blur


def main(scene: str, clip: Path, blurred: Path, metrics: Path, params_file: Path) -> None:
    """Write the scores of what `blur` made of `clip`."""
    params = load_params(params_file, f"scenes.{scene}.blur", BlurParams)
    with run.stage("score_blur", scene, seed=0):  # nothing here is drawn at random
        scores = score_blur(Clip.load(clip), BlurryClip.load(blurred), params)
        write_json(metrics, {"scene": scene, **scores})


if __name__ == "__main__":
    run.command(main)
