"""Straighten, crop and matte the frames of one scene, and pose the body in each."""

from pathlib import Path

import deblur_avatar.loading  # noqa: F401
from deblur_avatar import run
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.body_estimation.landmarks import detect_with_mediapipe
from deblur_avatar.config.reading import load_params
from deblur_avatar.files import write_json
from deblur_avatar.pipeline.preprocess import PreprocessParams, preprocess


def main(scene: str, blur: Path, body: Path, out: Path, metrics: Path, params_file: Path) -> None:
    """Turn a blurred clip into observations: blurred, sharp and, where known, exact."""
    params = load_params(params_file, f"scenes.{scene}.preprocess", PreprocessParams)
    schedule = load_params(params_file, "schedule", str)
    image_height = load_params(params_file, f"schedules.{schedule}.image_height", int)
    seed = load_params(params_file, "seed", int)

    with run.stage("preprocess", scene, seed):
        prepared = preprocess(
            BlurryClip.load(blur),
            Body.load(body),
            params,
            image_height=image_height,
            detect=detect_with_mediapipe,
        )
        prepared.save(out)
        write_json(metrics, prepared.metrics)


if __name__ == "__main__":
    run.command(main)
