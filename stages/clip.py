"""Bring the footage of one scene into the form that every source has."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.body import Body
from deblur_avatar.body_estimation.landmarks import detect_with_mediapipe
from deblur_avatar.config.reading import load_params
from deblur_avatar.pipeline.clip import ClipParams, load_clip


def main(scene: str, body: Path, out: Path, params_file: Path) -> None:
    """Write `<out>/clip` and the truth that only `evaluate` may see, `<out>/reference`."""
    params = load_params(params_file, f"scenes.{scene}.clip", ClipParams)
    seed = load_params(params_file, "seed", int)

    with run.stage("clip", scene, seed) as context:
        clip, reference = load_clip(
            params, Body.load(body), detect=detect_with_mediapipe, generator=context.generator
        )
        clip.save(out / "clip")
        reference.save(out / "reference")


if __name__ == "__main__":
    run.command(main)
