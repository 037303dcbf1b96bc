"""Overlap of body and matte where both are true: how much a perfect fit of the body could have.

    python -m benchmarks.body_overlap [--json FILE]

A person is wider than her body by clothes and hair, and a matte of a blurred frame is wider than
the body at one instant. Prints JSON: intersection over union as the check measures it
(`mask_body_iou`), of the studio and of the street with all truth given, which are drawn, and of the
real clip as it is estimated; once with each matte moved by one pixel against itself. Needs `dvc
repro preprocess@<scene>`; seconds.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from benchmarks.record import print_record
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.evaluation.body_silhouette import INSIDE
from deblur_avatar.evaluation.scene_measures import mask_body_iou

DATA = Path("data/preprocess")


def a_pixel_apart(observations: Observations) -> float:
    """Intersection over union of training frames' mattes with themselves, a pixel to the right."""
    inside = observations.mattes[list(observations.shown)] > INSIDE
    moved = torch.roll(inside, 1, dims=2)
    return float((inside & moved).sum() / (inside | moved).sum())


def row(observations: Observations) -> dict[str, Any]:
    """What a scene has."""
    overlap = mask_body_iou(observations)
    return {
        "mask_body_iou": None if overlap is None else round(overlap, 3),
        "a_pixel_apart": round(a_pixel_apart(observations), 3),
        "pixels": list(observations.mattes.shape[1:]),
    }


def measure(folder: Path) -> dict[str, Any]:
    """Rows by scene, and by what is true of it."""
    sharp = Observations.load(folder / "studio" / "exact")
    blurred = Observations.load(folder / "studio" / "blurred")
    middles = replace(blurred, poses=sharp.poses)
    return {
        "studio, sharp frames, all true": row(sharp),
        "studio, blurred frames, all true": row(middles),
        "street, blurred frames, all true": row(
            Observations.load(folder / "street_given" / "blurred")
        ),
        "real clip, as estimated": row(Observations.load(folder / "courtyard_two" / "blurred")),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--folder", type=Path, default=DATA)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    print_record(measure(options.folder), options.json)


if __name__ == "__main__":
    main()
