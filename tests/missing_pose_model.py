"""An environment without the heavy pose model, and stand-ins for its weights."""

import hashlib
from pathlib import Path

import pytest

from deblur_avatar.body_estimation import pose_model

WEIGHTS = b"weights of a pose model"


def without_heavy_model(monkeypatch: pytest.MonkeyPatch, folder: Path) -> Path:
    """Where the weights would lie, still empty; `WEIGHTS` are taken for the right ones."""
    file = folder / "pose_landmark_heavy.tflite"
    monkeypatch.setattr(pose_model, "heavy_file", lambda: file)
    monkeypatch.setattr(pose_model, "HEAVY_SHA256", hashlib.sha256(WEIGHTS).hexdigest())
    return file
