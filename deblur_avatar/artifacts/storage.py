"""Artifact storage: one frozen dataclass is one directory of plain files, and back.

A directory holds `manifest.json` (schema and small values), `tensors.safetensors` (arrays) and one
folder of 8-bit PNG files for each image stack. Nothing in it depends on the time, the machine or
the process that wrote it, so equal content is equal bytes.
"""

import dataclasses
import json
import math
import shutil
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
import torch
from jaxtyping import AbstractArray, jaxtyped
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from deblur_avatar.errors import ArtifactError
from deblur_avatar.readers.picture_codec import MAX_PIXELS, STORED_PNG, encoded, read_pixels
from deblur_avatar.run import in_threads

A = TypeVar("A", bound="Artifact")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Artifact:
    """What flows between stages: immutable, checked on construction and on loading.

    Field annotations are the schema: jaxtyping arrays (dimension names are shared across fields),
    `dict[str, Tensor]`, other artifacts, or JSON values; each may be `| None`. `UInt8` arrays
    whose dimensions end in `H W 3` or `H W` are stored as PNG files.

    Raises:
        ArtifactError: if a field has the wrong type, shape or a value that is not finite.
    """

    schema: ClassVar[str]
    # What fields are called in the files, where the code has another name by now.
    names_on_disk: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        try:
            with jaxtyped("context"):
                for name, kind in _fields(type(self)).items():
                    _check(f"{self.schema} {name}", getattr(self, name), kind)
            self.validate()
        except ArtifactError:
            raise
        except ValueError as error:
            raise ArtifactError(f"{self.schema}: {error}") from error

    def validate(self) -> None:
        """Check what annotations cannot say; overridden where there is such a thing.

        Raises:
            ValueError: naming the field, what was wanted and what came.
        """

    def save(self, folder: Path) -> None:
        """Write the artifact to `folder`, replacing it in one move: whole or not at all.

        Raises:
            ArtifactError: if the disk refuses.
        """
        folder = Path(folder)
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            scratch = folder.with_name(f".{folder.name}.scratch")
            shutil.rmtree(scratch, ignore_errors=True)  # of a process that was killed
            scratch.mkdir()
            try:
                self._write(scratch)
                if folder.exists():
                    shutil.rmtree(folder)
                scratch.rename(folder)
            finally:
                shutil.rmtree(scratch, ignore_errors=True)
        except (OSError, SafetensorError) as error:
            raise ArtifactError(f"cannot write {self.schema} to {folder}: {error}") from error

    def _write(self, folder: Path) -> None:
        manifest: dict[str, Any] = {"schema": self.schema}
        tensors: dict[str, Tensor] = {}
        for field, kind in _fields(type(self)).items():
            value, name = getattr(self, field), self.names_on_disk.get(field, field)
            if value is None:
                continue
            if isinstance(value, Artifact):
                (folder / name).mkdir()
                value._write(folder / name)
            elif _is_image(kind):
                _write_images(folder / name, value)
                manifest[name] = {"images": list(value.shape)}
            elif isinstance(value, Tensor):
                tensors[name] = value.detach().cpu().contiguous()
            elif kind == dict[str, Tensor]:
                manifest[name] = sorted(value)
                for key, tensor in value.items():
                    # A clone: safetensors refuses tensors that share memory.
                    tensors[f"{name}.{key}"] = tensor.detach().cpu().contiguous().clone()
            else:
                manifest[name] = value
        save_file(tensors, folder / "tensors.safetensors")
        text = json.dumps(manifest, indent=1, sort_keys=True, allow_nan=False)
        (folder / "manifest.json").write_text(text + "\n")

    @classmethod
    def load(cls: type[A], folder: Path) -> A:
        """Read and check an artifact.

        Raises:
            ArtifactError: if it is missing, damaged, or of another kind or version.
        """
        folder = Path(folder)
        manifest = _read_manifest(folder, cls.schema)
        try:
            tensors = load_file(folder / "tensors.safetensors")
        except (OSError, SafetensorError) as error:
            raise ArtifactError(f"{folder}/tensors.safetensors: {error}; {_REMEDY}") from error
        values: dict[str, Any] = {}
        for field, kind in _fields(cls).items():
            name = cls.names_on_disk.get(field, field)
            where = f"{folder}: {name}"
            nested = _artifact_class(kind)
            if nested is not None and (folder / name).is_dir():
                values[field] = nested.load(folder / name)
            elif name in tensors:
                values[field] = tensors[name]
            elif name not in manifest:
                values[field] = None
            elif _is_image(kind):
                values[field] = _read_images(folder / name, manifest[name], where)
            elif kind == dict[str, Tensor]:
                try:
                    values[field] = {key: tensors[f"{name}.{key}"] for key in manifest[name]}
                except (KeyError, TypeError) as error:
                    raise ArtifactError(f"{where}: lacks {error}; {_REMEDY}") from error
            else:
                values[field] = _json_value(manifest[name], kind)
        try:
            return cls(**values)
        except ArtifactError as error:
            raise ArtifactError(f"{folder}: {error}") from error


_REMEDY = "run `dvc repro` or `dvc pull`"
_MAX_VALUE = 2**63 - 1  # of a number in a manifest
_DTYPES = (
    torch.float16, torch.bfloat16, torch.float32, torch.float64, torch.bool,
    torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64,
)  # fmt: skip


def _fields(cls: type) -> dict[str, Any]:
    hints = typing.get_type_hints(cls)
    return {field.name: hints[field.name] for field in dataclasses.fields(cls)}


def _alternatives(kind: Any) -> tuple[Any, ...]:
    if isinstance(kind, types.UnionType) or typing.get_origin(kind) is typing.Union:
        return typing.get_args(kind)
    return (kind,)


def _array_kind(kind: Any) -> Any:
    for option in _alternatives(kind):
        if isinstance(option, type) and issubclass(option, AbstractArray):
            return option
    return None


def _artifact_class(kind: Any) -> type[Artifact] | None:
    for option in _alternatives(kind):
        if isinstance(option, type) and issubclass(option, Artifact):
            return option
    return None


def _is_image(kind: Any) -> bool:
    array = _array_kind(kind)
    if array is None or "uint8" not in array.dtypes:
        return False
    return bool(array.dim_str.endswith("H W 3") or array.dim_str.endswith("H W"))


def _check(where: str, value: Any, kind: Any) -> None:
    options = _alternatives(kind)
    if value is None:
        if type(None) not in options:
            raise ArtifactError(f"{where} is missing; {_REMEDY}")
        return
    array = _array_kind(kind)
    if array is not None:
        if not isinstance(value, Tensor) or not isinstance(value, array):
            came = (
                f"{value.dtype} {tuple(value.shape)}" if isinstance(value, Tensor) else type(value)
            )
            raise ArtifactError(f"{where} must be {array.__name__}, got {came}")
        _check_finite(where, value)
        return
    if kind == dict[str, Tensor] and isinstance(value, dict):
        for key, tensor in value.items():
            _check_finite(f"{where}.{key}", tensor)
        return
    if not any(_is_plain(value, option) for option in options):
        raise ArtifactError(f"{where} must be {kind}, got {type(value).__name__} {value!r:.80}")


def _check_finite(where: str, value: Tensor) -> None:
    if value.dtype not in _DTYPES:
        raise ArtifactError(f"{where} is of {value.dtype}, which no artifact holds; {_REMEDY}")
    if value.is_floating_point() and not bool(torch.isfinite(value).all()):
        raise ArtifactError(f"{where} holds values that are not finite")


def _is_plain(value: Any, kind: Any) -> bool:
    """Whether a JSON value is of a kind: finite numbers, each item of a tuple of the tuple's."""
    if isinstance(value, bool) or kind is bool:
        return isinstance(value, bool) and kind is bool
    if isinstance(value, int | float) and kind in (int, float):
        return isinstance(value, int | kind) and -_MAX_VALUE <= value <= _MAX_VALUE
    if isinstance(value, tuple) and typing.get_origin(kind) is tuple:
        return all(_is_plain(item, typing.get_args(kind)[0]) for item in value)
    return isinstance(value, typing.get_origin(kind) or kind) and not isinstance(value, tuple)


def _json_value(value: Any, kind: Any) -> Any:
    for option in _alternatives(kind):
        if typing.get_origin(option) is tuple and isinstance(value, list):
            return tuple(value)
    return value


def _read_manifest(folder: Path, schema: str) -> dict[str, Any]:
    try:
        manifest = json.loads((folder / "manifest.json").read_text())
    except FileNotFoundError:
        raise ArtifactError(f"no {schema} in {folder}; {_REMEDY}") from None
    except (OSError, ValueError, RecursionError) as error:
        raise ArtifactError(f"{folder}/manifest.json is damaged: {error}; {_REMEDY}") from error
    found = manifest.get("schema") if isinstance(manifest, dict) else None
    if found != schema:
        raise ArtifactError(f"{folder} holds {found!s:.60}, wanted {schema}; {_REMEDY}")
    return manifest


def _write_images(folder: Path, stack: Tensor) -> None:
    folder.mkdir()
    dims = 3 if stack.shape[-1] == 3 and stack.ndim > 3 else 2
    count = int(np.prod(stack.shape[:-dims]))  # -1 would not do for an empty stack
    images = stack.detach().cpu().reshape(count, *stack.shape[-dims:]).numpy()

    def write(index: int, image: NDArray[np.uint8]) -> None:
        pixels = image if dims == 3 else image[..., None]
        (folder / f"{index:06d}.png").write_bytes(encoded(pixels, ".png", STORED_PNG))

    in_threads(write, range(count), images)


def _read_images(folder: Path, entry: Any, where: str) -> Tensor:
    shape = _shape(entry)
    if shape is None:
        raise ArtifactError(f"{where}: the manifest's entry is damaged; {_REMEDY}")
    dims = 3 if shape[-1] == 3 and len(shape) > 3 else 2
    count = math.prod(shape[:-dims])
    paths = sorted(folder.glob("*.png"))
    if len(paths) != count:
        raise ArtifactError(f"{where}: wanted {count} images, found {len(paths)}; {_REMEDY}")
    # One before there is room: a size that only the manifest claims costs nothing.
    first = [_read_image(path, shape[-dims:]) for path in paths[:1]]
    images = np.empty((count, *shape[-dims:]), np.uint8)
    if first:
        images[0] = first[0]

    def read(index: int, path: Path) -> None:
        images[index] = _read_image(path, shape[-dims:])

    in_threads(read, range(len(first), count), paths[len(first) :])
    return torch.from_numpy(images).reshape(shape)


def _shape(entry: Any) -> tuple[int, ...] | None:
    """Sizes of a stack of images by its entry in the manifest; None if no stack can have them."""
    shape = entry.get("images") if isinstance(entry, dict) else None
    if not isinstance(shape, list) or len(shape) < 2:
        return None
    if not all(type(size) is int and 0 <= size <= MAX_PIXELS for size in shape):
        return None
    return tuple(shape) if math.prod(shape[-3:]) <= 3 * MAX_PIXELS else None


def _read_image(path: Path, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Decode a picture file whose header says that it is of the shape wanted."""
    try:
        image = read_pixels(path, (shape[1], shape[0])).values
    except ArtifactError as error:
        raise ArtifactError(f"{path} is not an image of shape {shape}; {_REMEDY}") from error
    image = image if len(shape) == 3 else image[..., 0]
    if image.dtype != np.uint8 or image.shape != shape:
        raise ArtifactError(f"{path} is not an image of shape {shape}; {_REMEDY}")
    return image
