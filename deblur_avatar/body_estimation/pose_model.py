"""Pose model files: which of MediaPipe's weights are installed, and installing the larger ones.

MediaPipe's pose model comes in three sizes. Its Python package carries the middle one, `full`; the
largest, `heavy`, is in the package that the same authors publish for JavaScript, and is put beside
`full` once an environment (`deblur-avatar setup`). It guesses places in space far better
(docs/decisions/0049-heavy-pose-model.md).
"""

import hashlib
import importlib.util
from pathlib import Path
from typing import Literal

from deblur_avatar.errors import ArtifactError

PoseModel = Literal["heavy", "full"]
COMPLEXITY: dict[PoseModel, int] = {"heavy": 2, "full": 1}  # MediaPipe's word for the size

HEAVY_SHA256 = "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe"
_PLACE = ("modules", "pose_landmark", "pose_landmark_heavy.tflite")  # where MediaPipe looks


def heavy_file() -> Path | None:
    """Where the weights of `heavy` lie or would lie; None without MediaPipe."""
    spec = importlib.util.find_spec("mediapipe")
    if spec is None or not spec.submodule_search_locations:
        return None
    return Path(spec.submodule_search_locations[0]).joinpath(*_PLACE)


def installed_model() -> PoseModel:
    """The largest model whose weights are there. MediaPipe itself brings `full`."""
    file = heavy_file()
    return "heavy" if file is not None and file.is_file() else "full"


def install_heavy(weights: bytes, come_from: str) -> Path:
    """Put the weights of `heavy` where MediaPipe looks for them; whole, or not at all.

    Args:
        weights: content of a file `pose_landmark_heavy.tflite`.
        come_from: said where they are refused.

    Raises:
        ArtifactError: if they are not the very weights that were tested, or MediaPipe is missing.
    """
    if hashlib.sha256(weights).hexdigest() != HEAVY_SHA256:
        raise ArtifactError(
            f"{come_from}: not the weights of MediaPipe's heavy pose model that were tested "
            f"(SHA-256 {HEAVY_SHA256[:12]}..., {len(weights)} bytes came); they are "
            "pose_landmark_heavy.tflite of its package for JavaScript, version 0.5.1675469404"
        )
    file = heavy_file()
    if file is None:
        raise ArtifactError("mediapipe is not installed; run once: deblur-avatar setup")
    part = file.with_suffix(".part")
    part.write_bytes(weights)
    part.replace(file)
    return file
