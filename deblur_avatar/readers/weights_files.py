"""Tensors from other people's `.pth` files, without running what those files ask to run.

A file has one of two forms. Since torch 1.6 it is a zip archive of a pickle, `data.pkl`, and one
member for each storage, uncompressed. Before, it was five pickles (a magic number, a version, facts
about the machine, the content, the storages' names) and then the storages, each after its length.
In both the content is a dictionary of tensors by name: part of a storage, and how it is laid out.

torch's own reader is not used: asked for weights alone it still makes temporary folders, and tuples
that are nested deeply enough end the process.
"""

import io
import math
import os
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from deblur_avatar.readers.pickles import (
    Refused,
    check_structure,
    readable,
)

MAX_BYTES = 1 << 30  # of all storages that are wanted; VGG16's largest file has 0.5 GB
MAX_STRUCTURE = 1 << 22  # bytes of what is not storages; VGG16's file has 4 kB of it
MAX_DIMENSIONS = 64
MAGIC, VERSION = 0x1950A86A20F9469CFC6C, 1001  # of the older form; torch/serialization.py
ZIP = b"PK\x03\x04"
DTYPES = {
    "FloatStorage": torch.float32, "DoubleStorage": torch.float64, "HalfStorage": torch.float16,
    "BFloat16Storage": torch.bfloat16, "LongStorage": torch.int64, "IntStorage": torch.int32,
    "ShortStorage": torch.int16, "CharStorage": torch.int8, "ByteStorage": torch.uint8,
}  # fmt: skip


@dataclass(frozen=True)
class _Storage:
    """A row of numbers that the pickle names and that lies elsewhere in the file."""

    key: str
    dtype: torch.dtype
    count: int

    @property
    def size(self) -> int:
        """Bytes."""
        return self.count * self.dtype.itemsize


@dataclass(frozen=True)
class _Layout:
    """What the pickle says of a tensor; checked once all of it has been read."""

    storage: Any
    offset: Any
    size: Any
    stride: Any

    def __setstate__(self, state: object) -> None:
        """Of a parameter, which old files say more of: whether it is trained, say."""


Content = Callable[[_Storage], bytes]


def load_pth(path: Path, wanted: Collection[str]) -> dict[str, Tensor]:
    """Read those tensors of a file that are wanted and there, on the CPU, with their own types.

    Raises:
        ArtifactError: if the file is missing, damaged, too large, holds something else than tensors
            by name, or names anything that they do not need; nothing of it has been executed then.
    """
    path = Path(path)
    with (
        readable(path, "no weights need", "Take the file from its publisher"),
        path.open("rb") as file,
    ):
        form = file.read(len(ZIP))
        file.seek(0)
        return _from_archive(file, wanted) if form == ZIP else _from_sequence(file, wanted)


def _from_archive(file: io.BufferedIOBase, wanted: Collection[str]) -> dict[str, Tensor]:
    length = os.fstat(file.fileno()).st_size
    with zipfile.ZipFile(file) as archive:
        # Below one folder, which has the name of the file that was saved first.
        members = {m.filename.partition("/")[2]: m for m in archive.infolist()}

        def content(name: str, most: int) -> bytes:
            member = members[name]
            size = member.file_size
            if size > min(most, length) or member.compress_size != size:
                raise ValueError(f"{name} claims {size} bytes; at most {most} are wanted there")
            return archive.read(member)

        if "byteorder" in members and content("byteorder", 16) != b"little":
            raise ValueError("its numbers are in the other order of bytes")
        layouts, _ = _unpickled(io.BytesIO(content("data.pkl", MAX_STRUCTURE)))
        return _tensors(layouts, wanted, lambda s: content(f"data/{s.key}", s.size))


def _from_sequence(file: io.BufferedIOBase, wanted: Collection[str]) -> dict[str, Tensor]:
    start = io.BytesIO(file.read(MAX_STRUCTURE))
    if _unpickled(start)[0] != MAGIC or _unpickled(start)[0] != VERSION:
        raise ValueError("it is neither a zip archive nor of torch's older form")
    if not _unpickled(start)[0]["little_endian"]:
        raise ValueError("its numbers are in the other order of bytes")
    layouts, storages = _unpickled(start)
    keys, _ = _unpickled(start)
    places: dict[str, int] = {}
    place = start.tell()
    for key in keys:
        file.seek(place)
        count = int.from_bytes(file.read(8), "little")
        if count != storages[key].count:
            raise ValueError(f"a storage has {count} numbers, {storages[key].count} are wanted")
        places[key] = place + 8
        place += 8 + storages[key].size
    length = os.fstat(file.fileno()).st_size
    if place > length:
        raise ValueError(f"it ends after {length} bytes of {place}")

    def content(storage: _Storage) -> bytes:
        file.seek(places[storage.key])
        return file.read(storage.size)

    return _tensors(layouts, wanted, content)


def _tensors(layouts: Any, wanted: Collection[str], content: Content) -> dict[str, Tensor]:
    if not isinstance(layouts, dict) or not all(
        isinstance(name, str) and isinstance(value, _Layout) for name, value in layouts.items()
    ):
        raise TypeError(f"it holds {type(layouts).__name__}, not weights by name")
    chosen = {name: _checked(layouts[name]) for name in wanted if name in layouts}
    storages = {layout.storage for layout in chosen.values()}
    if sum(storage.size for storage in storages) > MAX_BYTES:
        raise ValueError(f"over {MAX_BYTES >> 20} MB are wanted of it")
    rows = {s: torch.frombuffer(bytearray(content(s)), dtype=s.dtype) for s in storages}
    found = {
        # Refused by torch where it would reach beyond the storage.
        name: rows[layout.storage].as_strided(layout.size, layout.stride, layout.offset)
        for name, layout in chosen.items()
    }
    for name, tensor in found.items():
        if not bool(torch.isfinite(tensor).all()):
            raise ValueError(f"{name} holds values that are not finite")
    return found


def _checked(layout: _Layout) -> _Layout:
    """Refuse sizes that are none, and tensors that are larger than what they are part of."""
    numbers = (layout.offset, *layout.size, *layout.stride)
    if (
        not isinstance(layout.storage, _Storage)
        or len(numbers) > 2 * MAX_DIMENSIONS
        or not all(type(number) is int and 0 <= number < 2**63 for number in numbers)
        or math.prod(layout.size) > layout.storage.count
    ):
        raise ValueError("a tensor does not fit into its storage")
    return layout


def _unpickled(file: io.BufferedIOBase) -> tuple[Any, dict[str, _Storage]]:
    """The next pickle's content and the storages that it names; the file is left after it."""
    begin = file.tell()
    check_structure(file)
    end = file.tell()
    file.seek(begin)
    unpickler = _Unpickler(file, encoding="latin1")
    content = unpickler.load()
    file.seek(end)
    return content, unpickler.storages


class _Unpickler(pickle.Unpickler):
    """Knows what a dictionary of tensors is pickled as, and nothing else.

    What it hands to a file cannot be changed by it: methods, dtypes and `OrderedDict`.
    """

    def __init__(self, file: io.BufferedIOBase, *, encoding: str) -> None:
        super().__init__(file, encoding=encoding)
        self.storages: dict[str, _Storage] = {}

    def find_class(self, module: str, name: str) -> Any:
        if module in ("torch", "torch.cuda") and name in DTYPES:
            return DTYPES[name]
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if (module, name) in _TENSORS:
            return self._layout
        if (module, name) in _PARAMETERS:
            return self._parameter
        raise Refused(f"{module}.{name}")

    def persistent_load(self, key: Any) -> _Storage:
        """A storage: its type, name, device (which does not matter here) and length."""
        if not isinstance(key, tuple) or len(key) < 5 or key[0] != "storage" or any(key[5:]):
            raise Refused("a persistent object", key)
        _, dtype, name, _, count = key[:5]
        if not isinstance(dtype, torch.dtype) or type(name) is not str or type(count) is not int:
            raise Refused("a persistent object", key)
        if not 0 <= count < 2**63:
            raise ValueError("a storage of too many numbers")
        return self.storages.setdefault(name, _Storage(name, dtype, count))

    def _layout(
        self, storage: object, offset: object, size: object, stride: object, *more: object
    ) -> _Layout:
        return _Layout(storage, offset, size, stride)

    def _parameter(self, tensor: object, *more: object) -> object:
        return tensor


_TENSORS = (("torch._utils", "_rebuild_tensor"), ("torch._utils", "_rebuild_tensor_v2"))
_PARAMETERS = (("torch._utils", "_rebuild_parameter"), ("torch.nn.parameter", "Parameter"))
