"""ZJU-MoCap annotations (`annots.npy`): calibration, and which pictures the cameras took.

The file is a pickled dictionary. `cams` holds lists K, R, T, D, one entry a camera: OpenCV's
intrinsics (top left pixel's centre at 0), world to camera, T in *millimetres*, distortion
(k1, k2, p1, p2, k3). `ims` is a list over frames of `{"ims": [path of each camera's picture]}`.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import check_cameras
from deblur_avatar.readers.foreign_arrays import load_npy

PIXEL_CENTRE = 0.5  # ours; OpenCV puts the top left pixel's centre at 0
MILLIMETRES = 1000.0
MAX_VALUE = 1e30  # of any number: single precision, times a thousand
NUMBER = "[0-9]{1,18}"
DATED_PARTS = 5  # of a name with date and time; the fifth is the frame's number


@dataclass(frozen=True)
class Annotations:
    """All cameras and all pictures of a sequence; F frames, C cameras."""

    path: Path
    Ks: Float32[Tensor, "C 3 3"]  # pixels of the pictures as filmed
    viewmats: Float32[Tensor, "C 4 4"]  # metres
    distortion: Float32[Tensor, "C 5"]
    pictures: tuple[tuple[str, ...], ...]  # [frame][camera], below the folder

    def camera_name(self, camera: int) -> str:
        """The folder of a camera's pictures."""
        return Path(self.pictures[0][camera]).parent.name

    def frame_numbers(self, frames: range, cameras: Sequence[int]) -> list[int]:
        """The numbers in the names of the pictures, which `new_params` go by.

        Raises:
            ArtifactError: if a name has no number, cameras do not agree on a frame's, or frames
                are missing or there twice between the first and the last.
        """
        between = range(frames.start, frames[-1] + 1)
        numbers = [
            [_frame_number(self.pictures[f][c], self.path) for c in cameras] for f in between
        ]
        for frame, row in zip(between, numbers, strict=True):
            for camera, number in zip(cameras, row, strict=True):
                if number != row[0]:
                    raise ArtifactError(
                        f"{self.path}: frame {frame}: camera {self.camera_name(camera)} shows "
                        f"number {number}, {self.camera_name(cameras[0])} {row[0]}: one of them "
                        "dropped a frame; keep clip.frames before it"
                    )
        first = [row[0] for row in numbers]
        step = first[1] - first[0] if len(first) > 1 else 1
        for frame, before, after in zip(between[1:], first, first[1:], strict=False):
            if after - before != max(step, 1):
                raise ArtifactError(
                    f"{self.path}: frame {frame} has number {after} after {before}: frames are "
                    "missing or there twice; keep clip.frames on one side of it"
                )
        return first[:: frames.step]


def read_annotations(path: Path) -> Annotations:
    """Read and check the file; whether the pictures are there is seen when they are read.

    Raises:
        ArtifactError: if it is missing, damaged, wants to run code, lacks a key or a camera's
            entry, or holds a camera that cannot exist; says which.
    """
    content = load_npy(path)
    if not isinstance(content, dict) or not {"cams", "ims"} <= content.keys():
        found = ", ".join(content) if isinstance(content, dict) else "an array"
        raise ArtifactError(f"{path}: wanted a dictionary with cams and ims, got {found}")
    cams = content["cams"]
    if not isinstance(cams, Mapping) or not {"K", "R", "T", "D"} <= cams.keys():
        found = ", ".join(map(str, cams)) if isinstance(cams, Mapping) else repr(type(cams))
        raise ArtifactError(f"{path}: cams must hold K, R, T, D, got {found}")
    counts = {key: _length(cams[key]) for key in ("K", "R", "T", "D")}
    if len(set(counts.values())) != 1 or not counts["K"]:
        listed = ", ".join(f"{key} of {count}" for key, count in counts.items())
        raise ArtifactError(f"{path}: cams must describe the same cameras, got {listed}")
    pictures = _pictures(content["ims"], counts["K"], path)
    Ks = _stacked(cams["K"], (3, 3), f"{path}: cams K")
    Ks[:, :2, 2] += PIXEL_CENTRE
    viewmats = torch.eye(4).repeat(counts["K"], 1, 1)
    viewmats[:, :3, :3] = _stacked(cams["R"], (3, 3), f"{path}: cams R")
    viewmats[:, :3, 3] = _stacked(cams["T"], (3,), f"{path}: cams T") / MILLIMETRES
    try:
        check_cameras(Ks, viewmats)
    except ValueError as error:
        raise ArtifactError(f"{path}: {error}") from None
    return Annotations(
        path=path,
        Ks=Ks,
        viewmats=viewmats,
        distortion=_stacked(cams["D"], (5,), f"{path}: cams D"),
        pictures=pictures,
    )


def _pictures(ims: Any, cameras: int, path: Path) -> tuple[tuple[str, ...], ...]:
    if not _length(ims):
        raise ArtifactError(f"{path}: ims must list frames, got {ims!r:.60}")
    frames = []
    for frame, entry in enumerate(ims):
        names = entry.get("ims", ()) if isinstance(entry, Mapping) else ()
        if _length(names) != cameras:
            raise ArtifactError(
                f"{path}: ims[{frame}] must list one picture for each of {cameras} cameras, "
                f"got {_length(names)}"
            )
        frames.append(tuple(str(name) for name in names))
    return tuple(frames)


def _length(value: Any) -> int:
    is_list = isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim)
    return len(value) if is_list else 0


def _stacked(values: Any, shape: tuple[int, ...], where: str) -> Float32[Tensor, " C *shape"]:
    """One array a camera; columns count as vectors."""
    rows = []
    for camera, value in enumerate(values):
        try:
            row = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise ArtifactError(f"{where}[{camera}] must be numbers, got {value!r:.60}") from None
        if row.size != np.prod(shape) or (len(shape) > 1 and row.shape != shape):
            raise ArtifactError(f"{where}[{camera}] must be {shape}, got {row.shape}")
        if not (abs(row) <= MAX_VALUE).all():
            raise ArtifactError(f"{where}[{camera}] holds values that are not finite, or too large")
        rows.append(row.reshape(shape))
    return torch.from_numpy(np.stack(rows)).float()


def _frame_number(name: str, path: Path) -> int:
    """`Camera_B1/000012.jpg` is frame 12; so is a name whose fifth part between `_` is 12."""
    stem = Path(name).stem
    parts = stem.split("_")
    dated = parts[DATED_PARTS - 1] if len(parts) >= DATED_PARTS else ""
    found = re.fullmatch(NUMBER, dated) or re.search(f"(?<![0-9]){NUMBER}$", stem)
    if not found:
        raise ArtifactError(f"{path}: the name of the picture {name!r:.200} holds no frame number")
    return int(found[0])
