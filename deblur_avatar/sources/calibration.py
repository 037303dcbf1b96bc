"""Calibration files: Qualisys, Pose2Sim and COLMAP as cameras.

One reader a kind of file, chosen by how the file's name ends; a folder is COLMAP's. A reader turns
its format's axes, units and pixel origin into those of `Cameras`: OpenCV axes, metres, the centre
of the top left pixel at (0.5, 0.5).
"""

import math
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import check_cameras
from deblur_avatar.sources.calibrated_camera import CalibratedCamera, rigid
from deblur_avatar.sources.colmap_files import read_colmap

LONGEST_SIDE = 100_000  # pixels
PIXEL_CENTRE = 0.5  # Qualisys and Pose2Sim put the top left pixel's centre at 0


def read_calibration(path: Path, count: int) -> Cameras:
    """Read the calibration of `count` cameras, in the file's order.

    Args:
        path: `*.qca.txt` (Qualisys), `*.toml` (Pose2Sim), or the folder of a COLMAP reconstruction
            (`sparse/0`), whose order is that of its images' names.
        count: how many cameras the scene has.

    Raises:
        ArtifactError: naming the file and the camera, if it is missing or damaged, is of an
            unknown kind, holds another number of cameras or one that cannot exist.
    """
    if not path.exists():
        raise ArtifactError(f"no calibration {path}; check the scene's root and calibration")
    readers = [reader for ending, reader in READERS.items() if str(path).endswith(ending)]
    if path.is_dir():
        readers = [read_colmap]
    elif not readers:
        raise ArtifactError(
            f"{path}: unknown kind of calibration; known are {', '.join(READERS)} and the folder "
            "of a COLMAP reconstruction"
        )
    try:
        cameras = readers[0](path)
    except ArtifactError:
        raise
    except OSError as error:
        raise ArtifactError(f"cannot read {path}: {error.strerror}") from None
    except Exception as error:
        # XML and TOML raise more than their own errors: an unknown encoding, nesting, long numbers.
        raise ArtifactError(f"{path} is damaged: {error}") from error
    if len(cameras) != count:
        names = ", ".join(camera.name for camera in cameras)
        raise ArtifactError(f"{path} has {len(cameras)} cameras ({names}), the scene {count}")
    for camera in cameras:
        if not all(1 <= side <= LONGEST_SIDE for side in camera.size):
            size = " x ".join(f"{side:.6g}" for side in camera.size)
            raise ArtifactError(
                f"{path}: camera {camera.name}: its pictures have {size} pixels, wanted 1 to "
                f"{LONGEST_SIDE} on a side"
            )
        numbers = torch.from_numpy(camera.K)[None], torch.from_numpy(camera.viewmat)[None]
        try:
            check_cameras(*numbers)
        except ValueError as error:
            reason = str(error).removeprefix("camera 0: ")
            raise ArtifactError(f"{path}: camera {camera.name}: {reason}") from error
    try:
        return Cameras(
            Ks=_stacked([camera.K for camera in cameras]),
            viewmats=_stacked([camera.viewmat for camera in cameras]),
            distortion=_stacked([camera.distortion for camera in cameras]),
            sizes=torch.tensor([[round(side) for side in camera.size] for camera in cameras]),
            names=tuple(camera.name for camera in cameras),
        )
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from None


def _stacked(arrays: list[np.ndarray]) -> torch.Tensor:
    return torch.from_numpy(np.stack(arrays)).float()


def _read_qualisys(path: Path) -> list[CalibratedCamera]:
    """Qualisys Track Manager's XML.

    Intrinsics are in 1/64 pixels. `r11`..`r33`, transposed, turn the camera's axes (+X right,
    +Y up, -Z forward) into the world's; x, y, z is where the camera stands, millimetres.
    """
    return [_qualisys_camera(path, node) for node in ElementTree.parse(path).iter("camera")]


def _qualisys_camera(path: Path, node: ElementTree.Element) -> CalibratedCamera:
    name = node.get("serial", "without serial")

    def number(element: str, attribute: str) -> float:
        found = node.find(element)
        value = None if found is None else found.get(attribute)
        return _number(value, f"{path}: camera {name}: {element} {attribute}")

    K = np.eye(3)
    K[0, 0], K[1, 1] = (number("intrinsic", f"focalLength{axis}") / 64 for axis in "UV")
    K[:2, 2] = [number("intrinsic", f"centerPoint{axis}") / 64 + PIXEL_CENTRE for axis in "UV"]
    rotation = [[number("transform", f"r{row}{column}") for column in "123"] for row in "123"]
    centre = np.array([number("transform", axis) / 1000 for axis in "xyz"])
    # Inverted, then turned by pi about X: from +Y up, -Z forward to OpenCV's axes.
    opencv_from_world = np.diag([1.0, -1.0, -1.0]) @ np.array(rotation)
    coefficients = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1",
                    "tangentalDistortion2", "radialDistortion3")  # fmt: skip
    edges = {edge: number("fov_video", edge) for edge in ("left", "top", "right", "bottom")}
    size = (edges["right"] - edges["left"] + 1, edges["bottom"] - edges["top"] + 1)
    return CalibratedCamera(
        name=name,
        K=K,
        viewmat=rigid(opencv_from_world, -opencv_from_world @ centre),
        distortion=np.array([number("intrinsic", key) for key in coefficients]),
        size=size,
    )


def _read_pose2sim(path: Path) -> list[CalibratedCamera]:
    """Pose2Sim's TOML: a table a camera, OpenCV's conventions, rotation as axis-angle, metres."""
    text = path.read_text()
    if re.search(r"(\w+\s*\.\s*){9}", text):  # tomllib needs time and memory as their square
        raise ArtifactError(f"{path} is damaged: tables are nested nine levels deep, wanted one")
    tables = tomllib.loads(text)
    return [
        _pose2sim_camera(f"{path}: camera {key}", key, table)
        for key, table in tables.items()
        if isinstance(table, dict) and key != "metadata"
    ]


def _pose2sim_camera(where: str, key: str, table: Mapping[str, Any]) -> CalibratedCamera:
    if table.get("fisheye", False):
        raise ArtifactError(f"{where}: fisheye lenses are not modelled; undistort the video first")
    K = _array(table, "matrix", where, (3, 3))
    K[:2, 2] += PIXEL_CENTRE
    distortion = _array(table, "distortions", where, (None,))
    if not 4 <= len(distortion) <= 5:
        raise ArtifactError(f"{where}: distortions must be 4 or 5 numbers, got {len(distortion)}")
    rotation, _ = cv2.Rodrigues(_array(table, "rotation", where, (3,)))
    size = _array(table, "size", where, (2,))
    return CalibratedCamera(
        name=str(table.get("name", key)),
        K=K,
        viewmat=rigid(rotation, _array(table, "translation", where, (3,))),
        distortion=np.pad(distortion, (0, 5 - len(distortion))),
        size=(float(size[0]), float(size[1])),
    )


READERS: dict[str, Callable[[Path], list[CalibratedCamera]]] = {
    ".qca.txt": _read_qualisys,
    ".toml": _read_pose2sim,
}


def _array(
    table: Mapping[str, Any], key: str, where: str, shape: tuple[int | None, ...]
) -> np.ndarray:
    if key not in table:
        raise ArtifactError(f"{where}: {key} is missing")
    try:
        values = np.array(table[key], dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ArtifactError(f"{where}: {key} must be numbers, got {table[key]!r:.80}") from error
    if len(values.shape) != len(shape) or any(
        wanted not in (None, found) for wanted, found in zip(shape, values.shape, strict=True)
    ):
        raise ArtifactError(f"{where}: {key} must have shape {shape}, got {values.shape}")
    return values


def _number(text: str | None, where: str) -> float:
    try:
        value = float(text if text is not None else "")
    except ValueError:
        raise ArtifactError(f"{where} must be a number, got {text!r}") from None
    if not math.isfinite(value):
        raise ArtifactError(f"{where} must be finite, got {text!r}")
    return value
