"""What a scored camera shows of the surface that the training camera saw, and in which light.

    python -m benchmarks.seen_surface [--scene courtyard_two] [--methods lean agnostic]
                                      [--folder data] [--picture FILE] [--json FILE]

PSNR of the seen surface is a mean over these pixels alone. Prints JSON, a camera at a time: which
share of the person they are, how bright they truly are (mean of encoded values, of 1), and by
method how bright it renders them and its PSNR over them and over the whole person. The picture has
a row for each of the last camera's first views: the seen surface in red, the truth, the methods.
Needs `dvc repro fusion@<scene>-<method>`; a minute.
"""

import argparse
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from benchmarks.record import print_record
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.evaluation.comparisons import Comparison, compare_views
from deblur_avatar.evaluation.truth_views import TruthView, truth_views

DATA = Path("data")
ROWS, ENLARGED = 3, 2  # views and pixels of the picture


def compared(
    folder: Path, scene: str, methods: Sequence[str]
) -> tuple[tuple[str, ...], dict[str, list[Comparison]]]:
    """Names of the cameras, and each method's renders of all training frames' test views."""
    observations = Observations.load(folder / "preprocess" / scene / "blurred")
    reference = Reference.load(folder / "clip" / scene / "reference")
    views = [v for v in truth_views(observations, reference) if not v.novel_pose]
    renders = {}
    for method in methods:
        fitted = folder / "fusion" / f"{scene}-{method}"
        model = avatar_from_artifact(
            Avatar.load(fitted / "avatar"), observations.body, torch.device("cpu")
        )
        motion = Motion.load(fitted / "motion")
        renders[method] = compare_views(model, observations, reference, motion, views)
    return observations.cameras.names, renders


def brightness(pictures: Sequence[UInt8[Tensor, "H W 3"]], views: Sequence[TruthView]) -> float:
    """Mean of the seen pixels' encoded values, of 1."""
    pairs = zip(pictures, views, strict=True)
    return float(torch.cat([picture[view.seen] for picture, view in pairs]).float().mean() / 255)


def of_camera(renders: Mapping[str, Sequence[Comparison]]) -> dict[str, Any]:
    """What one camera shows."""
    views = [comparison.view for comparison in next(iter(renders.values()))]
    seen, person = (
        sum(int(getattr(view, name).sum()) for view in views) for name in ("seen", "foreground")
    )
    row: dict[str, Any] = {
        "views": len(views),
        "seen_share": round(seen / person, 3),
        "brightness": round(brightness([view.image for view in views], views), 3),
    }
    for method, comparisons in renders.items():
        scores = {
            name: round(float(np.mean([one.scores[name] for one in comparisons])), 2)
            for name in ("psnr_seen", "psnr_foreground")
        }
        light = brightness([one.render for one in comparisons], views)
        row[method] = {**scores, "brightness": round(light, 3)}
    return row


def marked(image: UInt8[Tensor, "H W 3"], seen: Bool[Tensor, "H W"]) -> np.ndarray:
    """A picture at half its light, the seen surface in red."""
    half = image.numpy() // 2
    half[seen.numpy()] = (255, 40, 40)
    return half


def picture(renders: Mapping[str, Sequence[Comparison]]) -> np.ndarray:
    """The first views of a camera, enlarged."""
    rows = []
    for row in range(ROWS):
        shown = [comparisons[row] for comparisons in renders.values()]
        view = shown[0].view
        pictures = [marked(view.image, view.seen), view.image.numpy()]
        rows.append(cv2.hconcat(pictures + [one.render.numpy() for one in shown]))
    return cv2.resize(
        cv2.vconcat(rows), None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_NEAREST
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scene", default="courtyard_two")
    parser.add_argument("--methods", nargs="+", default=["lean", "agnostic"])
    parser.add_argument("--folder", type=Path, default=DATA)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    names, renders = compared(options.folder, options.scene, options.methods)
    cameras = [key for key, _ in groupby(one.view.camera for one in renders[options.methods[0]])]
    of = {
        camera: {
            method: [one for one in all_ if one.view.camera == camera]
            for method, all_ in renders.items()
        }
        for camera in cameras
    }
    print_record({names[camera]: of_camera(of[camera]) for camera in cameras}, options.json)
    if options.picture:
        cv2.imwrite(str(options.picture), picture(of[cameras[-1]])[..., ::-1])


if __name__ == "__main__":
    main()
