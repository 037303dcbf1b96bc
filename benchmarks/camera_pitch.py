"""How far down cameras look on people whom nobody told: up, as a clip of one camera tells it.

    python -m benchmarks.camera_pitch --scene NAME --clips CLIP... [--folder data] [--json FILE]

The world of one's own clip is the camera's. Each CLIP is a folder that `deblur-avatar video <file
of one camera> --name <camera>` has made, called as the camera of a calibrated scene whose world has
+Z up (`courtyard_two`). Prints JSON, a camera at a time: pitch and roll as calibrated and as
the person tells them, and the angle between both ups, before (the picture's up) and with it. Needs
`dvc repro preprocess@<scene>`; seconds.
"""

import argparse
import math
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.record import print_record
from deblur_avatar.animation.stage import stage_of_clip
from deblur_avatar.artifacts.observations import Observations

DATA = Path("data")
GRAVITY_UP = torch.tensor([0.0, 0.0, 1.0])  # of the calibrated world


def pitch(up: Float[Tensor, " 3"]) -> float:
    """How far a camera looks up, degrees, of an up in its axes."""
    return math.degrees(math.atan2(up[2], -up[1]))


def roll(up: Float[Tensor, " 3"]) -> float:
    """How far to the right of its picture's up a camera sees an up in its axes, degrees."""
    return math.degrees(math.atan2(up[0], -up[1]))


def apart(one: Float[Tensor, " 3"], other: Float[Tensor, " 3"]) -> float:
    """Angle between two unit vectors, degrees."""
    return math.degrees(math.acos(float((one @ other).clamp(-1, 1))))


def row(told: Float[Tensor, " 3"], true: Float[Tensor, " 3"]) -> dict[str, float]:
    """What a camera's clip tells, beside its calibration; both ups in the camera's axes."""
    figures = {
        "true_pitch_deg": pitch(true),
        "true_roll_deg": roll(true),
        "told_pitch_deg": pitch(told),
        "told_roll_deg": roll(told),
        "off_by_deg": apart(told, true),
        "picture_off_by_deg": apart(torch.tensor([0.0, -1.0, 0.0]), true),
    }
    return {name: round(figure, 1) for name, figure in figures.items()}


def measure(calibrated: Observations, clips: list[Path]) -> dict[str, Any]:
    """Rows by camera."""
    cameras = calibrated.cameras
    rows = {}
    for clip in clips:
        view = cameras.viewmats[cameras.names.index(clip.name)]
        seen = Observations.load(clip / "data" / "preprocess" / clip.name / "blurred")
        told = stage_of_clip(seen, seen.poses.betas).up
        rows[clip.name] = row(told, view[:3, :3] @ GRAVITY_UP)
    return rows


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scene", required=True, help="calibrated, of the same cameras")
    parser.add_argument("--clips", nargs="+", type=Path, required=True, help="folders")
    parser.add_argument("--folder", type=Path, default=DATA, help="of the pipeline's data")
    parser.add_argument("--json", type=Path, help="a file for the record")
    arguments = parser.parse_args()
    calibrated = Observations.load(arguments.folder / "preprocess" / arguments.scene / "blurred")
    print_record(measure(calibrated, arguments.clips), arguments.json)


if __name__ == "__main__":
    main()
