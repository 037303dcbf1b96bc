"""SMPL: a licensed model file (`.pkl` or `.npz`) as a `Body`.

The model files of SMPL (smpl.is.tue.mpg.de, free for research after registration) are read where
the user has put them and are never shipped: the original pickles of Python 2, whose classes stay
strangers (`deblur_avatar.readers.foreign_arrays`), and `.npz` files with the same keys.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch
from pydantic import Field

from deblur_avatar.artifacts.body import (
    SMPL_JOINT_NAMES,
    SMPL_PARENTS,
    Body,
)
from deblur_avatar.config.reading import expand_environment, missing_file
from deblur_avatar.config.section import Params
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.readers.foreign_arrays import Record, load_arrays, load_npz


class SmplBodyParams(Params):
    """A licensed SMPL file; `file` may hold `$(VARIABLE)` from the environment."""

    source: Literal["smpl"]
    file: str
    shape_components: Annotated[int, Field(ge=1, le=300)]

    def build(self) -> Body:
        """Read it, as `read_smpl`."""
        where = f"bodies: file (an SMPL model, from {DOWNLOAD_PAGE}; or use the body anny)"
        return read_smpl(Path(expand_environment(self.file, where)), self.shape_components)

    def missing_files(self, where: str) -> tuple[str, ...]:
        """The model's file, where it is not here."""
        return missing_file(self.file, f"{where}.file", "SMPL file")


DOWNLOAD_PAGE = "https://smpl.is.tue.mpg.de"
LICENCE = f"SMPL model licence: non-commercial research, no redistribution; see {DOWNLOAD_PAGE}"
JOINTS = len(SMPL_JOINT_NAMES)
ROW_SUM = 1e-2  # by which the sum of a vertex's weights may differ from 1

# Shape of each array; V vertices, B shape numbers, T triangles.
_KEYS = {
    "v_template": "V 3", "shapedirs": "V 3 B", "posedirs": "V 3 D", "weights": "V J",
    "J_regressor": "J V", "kintree_table": "2 J", "f": "T 3",
}  # fmt: skip


def read_smpl(path: Path, shape_components: int) -> Body:
    """Read SMPL with its first `shape_components` shape directions.

    Joints follow from the file's regressor, which is linear, so that they are linear in the shape
    too. SMPL's axes and joint order are those of `Body` already.

    Raises:
        ConfigError: if there is no such file, with the page to get it from, or if it has fewer
            shape directions than asked for.
        ArtifactError: if it is damaged, of another format, or of another model (SMPL-H, SMPL-X).
    """
    path = Path(path)
    if not path.is_file():
        raise ConfigError(
            f"no SMPL model at {path}; register at {DOWNLOAD_PAGE}, download the model (.pkl or "
            ".npz) and set the body's `file` to where it lies, or use the body `anny`"
        )
    content = _checked(path, _read(path))
    shape_dirs = content["shapedirs"]
    if shape_dirs.shape[2] < shape_components:
        raise ConfigError(
            f"{path} has {shape_dirs.shape[2]} shape directions, shape_components asks for "
            f"{shape_components}"
        )
    shape_dirs = shape_dirs[:, :, :shape_components]
    try:
        return _body(content, shape_dirs)
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from None


def _body(content: dict[str, Any], shape_dirs: Any) -> Body:
    regressor = content["J_regressor"]
    return Body(
        vertices=_tensor(content["v_template"]),
        shape_dirs=_tensor(shape_dirs),
        joints=_tensor(regressor @ content["v_template"]),
        joint_dirs=_tensor(np.einsum("jv,vcb->jcb", regressor, shape_dirs)),
        pose_dirs=_tensor(content["posedirs"]),
        parents=SMPL_PARENTS,
        # Rows of the published files sum to 1 within a few float32 steps only.
        lbs_weights=_tensor(content["weights"] / content["weights"].sum(1, keepdims=True)),
        faces=torch.from_numpy(content["f"].astype(np.int64)),
        uvs=None,
        joint_names=SMPL_JOINT_NAMES,
        licence=LICENCE,
    )


def _read(path: Path) -> dict[str, Any]:
    if path.suffix == ".pkl":
        return load_arrays(path)
    if path.suffix == ".npz":
        return dict(load_npz(path, _KEYS))
    raise ConfigError(f"{path}: an SMPL model is a .pkl or .npz file, got {path.suffix!r}")


def _checked(path: Path, content: dict[str, Any]) -> dict[str, Any]:
    missing = [key for key in _KEYS if key not in content]
    if missing:
        raise ArtifactError(f"{path} is not an SMPL model: it lacks {', '.join(missing)}")
    sizes = {"3": 3, "2": 2}
    arrays = {}
    for key, dimensions in _KEYS.items():
        value = content[key]
        if isinstance(value, Record):
            raise ArtifactError(f"{path}: {key} is an unevaluated {value.name} expression")
        array = np.asarray(value)
        names = dimensions.split()
        if array.ndim != len(names) or array.dtype.kind not in "fiu":
            raise ArtifactError(f"{path}: {key} must be [{dimensions}] numbers, got {array.shape}")
        for name, size in zip(names, array.shape, strict=True):
            if sizes.setdefault(name, size) != size:
                raise ArtifactError(
                    f"{path}: {key} must be [{dimensions}] with {name} = {sizes[name]}, "
                    f"got {array.shape}"
                )
        if not np.isfinite(array).all():
            raise ArtifactError(f"{path}: {key} holds values that are not finite")
        arrays[key] = array
    weights = arrays["weights"]
    if not weights.size:
        raise ArtifactError(f"{path}: weights must be [V J], got {weights.shape}")
    if weights.min() < 0 or abs(weights.sum(1) - 1).max() > ROW_SUM:
        raise ArtifactError(f"{path}: rows of weights must be shares that sum to 1")
    # The root's parent is written as -1 or as the largest unsigned number.
    parents = tuple(int(p) if 0 <= int(p) < JOINTS else -1 for p in arrays["kintree_table"][0])
    if parents != SMPL_PARENTS:
        raise ArtifactError(
            f"{path} has {sizes['J']} joints of another order; wanted SMPL with {JOINTS} joints "
            f"(not SMPL-H or SMPL-X), from {DOWNLOAD_PAGE}"
        )
    return arrays


def _tensor(array: Any) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
