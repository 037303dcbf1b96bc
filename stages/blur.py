"""Blur a sharp clip as a slower shutter would have."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.blur import BlurParams, blur


def main(scene: str, clip: Path, out: Path, params_file: Path) -> None:
    """Average windows of the clip's frames, once more of them are interpolated."""
    params = load_params(params_file, f"scenes.{scene}.blur", BlurParams)
    with run.stage("blur", scene, seed=0):  # nothing here is drawn at random
        blur(Clip.load(clip), params).save(out)


if __name__ == "__main__":
    run.command(main)
