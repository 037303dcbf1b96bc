"""COLMAP reconstructions as calibration: `cameras` and `images`, binary or text.

Conventions. One registered image stands for one camera of the scene; cameras come in the natural
order of the images' names. COLMAP's axes and pixels are ours; its unit is whatever it was aligned
to, and must be the metre. Lenses: OpenCV's k1, k2, p1, p2, k3 and what these contain.

pycolmap says which parameters a lens has. It does not read the files: of a damaged count its reader
makes a loop without an end.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.calibrated_camera import CalibratedCamera, rigid
from deblur_avatar.sources.footage import natural_order

LENSES = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
REMEDY = "straighten videos and reconstruction (`colmap image_undistorter`) and give the new one"


class _Lens(NamedTuple):
    model: str
    size: tuple[int, int]
    params: tuple[float, ...]


class _View(NamedTuple):
    name: str
    camera: int
    quat: tuple[float, ...]  # wxyz
    translation: tuple[float, ...]


def read_colmap(folder: Path) -> list[CalibratedCamera]:
    """Read the cameras of a reconstruction's folder.

    Raises:
        ArtifactError: if a file is missing or a lens is none of those we straighten.
        Exception: of any kind, if a file is damaged.
    """
    for ending, read_lenses, read_views in (
        (".bin", _binary_lenses, _binary_views),
        (".txt", _text_lenses, _text_views),
    ):
        paths = folder / f"cameras{ending}", folder / f"images{ending}"
        if all(path.is_file() for path in paths):
            lenses, views = read_lenses(paths[0]), list(read_views(paths[1]))
            views.sort(key=lambda view: natural_order(view.name))
            return [_camera(folder, view, lenses[view.camera]) for view in views]
    raise ArtifactError(
        f"{folder} holds no reconstruction of COLMAP; wanted cameras.bin and images.bin, or .txt"
    )


def _camera(folder: Path, view: _View, lens: _Lens) -> CalibratedCamera:
    import pycolmap  # 134 MB of libraries, for those alone who have such files

    where = f"{folder}: camera {view.name}"
    if lens.model not in LENSES:
        raise ArtifactError(f"{where}: lens {lens.model}, wanted {', '.join(LENSES)}; {REMEDY}")
    known: Any = pycolmap.Camera.create_from_model_name(1, lens.model, 1.0, 1, 1)
    names = known.params_info.split(", ")
    values = dict(zip(names, lens.params, strict=True))
    values["k1"] = values.pop("k", values.get("k1", 0.0))  # SIMPLE_RADIAL's only one
    beyond = [name for name in ("k4", "k5", "k6") if values.get(name, 0.0) != 0.0]
    if beyond:
        raise ArtifactError(f"{where}: lens {lens.model} with {', '.join(beyond)}; {REMEDY}")
    K = np.eye(3)
    K[0, 0], K[1, 1] = (values.get(name, values.get("f")) for name in ("fx", "fy"))
    K[0, 2], K[1, 2] = values["cx"], values["cy"]
    w, x, y, z = view.quat
    rotation = pycolmap.Rotation3d(np.array([x, y, z, w])).matrix()
    return CalibratedCamera(
        name=view.name,
        K=K,
        viewmat=rigid(rotation, np.array(view.translation)),
        distortion=np.array([values.get(name, 0.0) for name in COEFFICIENTS]),
        size=lens.size,
    )


def _text_rows(path: Path) -> Iterator[list[str]]:
    for line in path.read_text().splitlines():
        if not line.startswith("#"):
            yield line.split()


def _text_lenses(path: Path) -> dict[int, _Lens]:
    return {
        int(row[0]): _Lens(row[1], (int(row[2]), int(row[3])), tuple(map(float, row[4:])))
        for row in _text_rows(path)
        if row
    }


def _text_views(path: Path) -> Iterator[_View]:
    rows = list(_text_rows(path))
    for row in rows[::2]:  # the others list points, and may be empty
        numbers = tuple(map(float, row[1:8]))
        yield _View(" ".join(row[9:]), int(row[8]), numbers[:4], numbers[4:])


def _binary_lenses(path: Path) -> dict[int, _Lens]:
    import pycolmap

    content = path.read_bytes()
    lenses, at = {}, 8
    for _ in range(struct.unpack_from("<Q", content)[0]):
        key, number, width, height = struct.unpack_from("<iiQQ", content, at)
        model = pycolmap.CameraModelId(number).name
        count = len(pycolmap.Camera.create_from_model_name(1, model, 1.0, 1, 1).params)
        lenses[key] = _Lens(
            model, (width, height), struct.unpack_from(f"<{count}d", content, at + 24)
        )
        at += 24 + 8 * count
    return lenses


def _binary_views(path: Path) -> Iterator[_View]:
    content = path.read_bytes()
    at = 8
    for _ in range(struct.unpack_from("<Q", content)[0]):
        _, *pose, camera = struct.unpack_from("<I7dI", content, at)
        end = content.index(b"\0", at + 64)
        yield _View(content[at + 64 : end].decode(), camera, tuple(pose[:4]), tuple(pose[4:]))
        at = end + 9 + 24 * struct.unpack_from("<Q", content, end + 1)[0]
