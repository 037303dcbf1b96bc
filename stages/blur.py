"""Blur a sharp clip as a slower shutter would have."""

from pathlib import Path

from deblur_avatar import run
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.blur import BlurParams, blur


def main(scene: str, clip: Path, out: Path, metrics: Path, params_file: Path) -> None:
    """Blur a sharp clip as a slower shutter would have; `clip` holds `clip/` (and more)."""
    params = load_params(params_file, f"scenes.{scene}.blur", BlurParams)
    with run.stage("blur", scene, seed=0):  # nothing here is drawn at random
        blurry, measured = blur(Clip.load(clip / "clip"), params)
        blurry.save(out)
        run.write_json(metrics, {"scene": scene, **measured})


if __name__ == "__main__":
    run.command(main)
