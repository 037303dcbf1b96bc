"""Array files of other programs: pickles, `.npy` and `.npz`, read with restrictions.

One guard for all three: `unpickling` reads the file in a process of its own, with bounded memory
and time, which runs nothing that the file asks for and hands back plain arrays. Whatever happens to
that process, the file is refused with one error.
"""

import io
import json
import math
import os
import subprocess
import sys
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from deblur_avatar.errors import ArtifactError
from deblur_avatar.readers import unpickling

MAX_BYTES = 1 << 30  # of a file, and of a matrix that unfolds; SMPL's largest file has 250 MB
MAX_MEMORY = 3 << 30  # of the process, which holds file, arrays and answer, and its libraries
MAX_SECONDS = 60  # of processor time; SMPL's largest file takes 2


@dataclass(frozen=True)
class Record:
    """An object of a class that is known by name only, and its pickled state."""

    name: str
    state: dict[Any, Any]


def load_arrays(path: Path) -> dict[str, Any]:
    """Read a pickled dictionary, written by Python 2 or 3.

    Arrays come as numpy arrays, sparse matrices and chumpy arrays too. A chumpy expression whose
    value would have to be computed stays a `Record`.

    Raises:
        ArtifactError: if the file is missing, damaged, too large, not a dictionary, or names a
            class that is not on the list; nothing of it has been executed then.
    """
    return _dictionary(_read([Path(path)], "pickle")[0], path)


def load_npy(path: Path) -> NDArray[Any] | dict[str, Any]:
    """Read a `.npy` file: an array of numbers, or the dictionary that was saved as one of objects.

    Raises:
        ArtifactError: as `load_arrays`, and for arrays of other objects.
    """
    return load_npy_files([path])[0]


def load_npy_files(paths: Sequence[Path]) -> list[NDArray[Any] | dict[str, Any]]:
    """Read many `.npy` files at the cost of one process; as `load_npy`."""
    contents = _read([Path(path) for path in paths], "npy")
    return [
        content
        if isinstance(content, np.ndarray) and not content.dtype.hasobject
        else _dictionary(content, path)
        for path, content in zip(paths, contents, strict=True)
    ]


def load_npz(path: Path, wanted: Collection[str]) -> dict[str, NDArray[Any]]:
    """Read those arrays of an `.npz` archive that are wanted and there; no pickled objects.

    Raises:
        ArtifactError: if the file is missing, damaged, or unfolds to too much.
    """
    content: dict[str, NDArray[Any]] = _read([Path(path)], "npz", wanted)[0]
    return content


def _read(paths: Sequence[Path], form: str, wanted: Collection[str] = ()) -> list[Any]:
    for path in paths:
        try:
            size = path.stat().st_size
        except (OSError, ValueError) as error:  # a name with a zero byte
            reason = getattr(error, "strerror", None) or error
            raise ArtifactError(f"cannot read {path}: {reason}") from None
        if size > MAX_BYTES:
            raise ArtifactError(
                f"{path} has {size >> 20} MB, at most {MAX_BYTES >> 20} MB are read; "
                "is it the file it should be?"
            )
    request = {
        "paths": [str(path.absolute()) for path in paths],
        "form": form, "wanted": list(wanted), "memory": MAX_MEMORY, "seconds": MAX_SECONDS,
    }  # fmt: skip
    try:
        done = subprocess.run(
            [sys.executable, "-P", unpickling.__file__],
            input=json.dumps(request).encode(),
            capture_output=True,
            check=False,
            timeout=10 * MAX_SECONDS,  # by the clock: a pipe that never ends takes no other time
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},  # threads reserve memory
        )
    except subprocess.TimeoutExpired:
        done = subprocess.CompletedProcess([], -1)
    if done.returncode == unpickling.REFUSED:
        raise _refusal(json.loads(done.stderr), paths)
    if done.returncode != 0:
        raise ArtifactError(
            f"{paths[0]}{' or a file after it' * (len(paths) > 1)} is not a readable "
            f"{paths[0].suffix or 'data'} file: reading it took over {MAX_SECONDS} s or "
            f"{MAX_MEMORY >> 20} MB, or ended the reader"
        )
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as answer:
        arrays = {name: answer[name] for name in answer.files}
    return [_unfolded(tree, arrays) for tree in json.loads(arrays["tree"].tobytes())]


def _refusal(answer: dict[str, Any], paths: Sequence[Path]) -> ArtifactError:
    path = paths[answer["index"]]
    if answer["refused"] is not None:
        return ArtifactError(
            f"{path} wants to run {answer['refused']}, which no data file needs; nothing was "
            "executed. Take the file from its publisher, or save it again as .npz"
        )
    return ArtifactError(
        f"{path} is not a readable {path.suffix or 'data'} file: {answer['damage']}"
    )


def _unfolded(tree: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """A value from its JSON, as `unpickling.written` made it."""
    if not isinstance(tree, list):
        return tree
    kind, *parts = tree

    def inside(values: list[Any]) -> list[Any]:
        return [_unfolded(value, arrays) for value in values]

    if kind == "dict":
        return dict(zip(inside(parts[0]), inside(parts[1]), strict=True))
    if kind in ("array", "scalar"):
        array = arrays[f"arr_{parts[0]}"]
        return array if kind == "array" else array[()]
    if kind == "objects":
        objects = np.empty(math.prod(parts[0]), object)
        objects[:] = inside(parts[1])
        return objects.reshape(parts[0])
    if kind == "record":
        return Record(parts[0], _unfolded(parts[1], arrays))
    if kind == "bytes":
        return parts[0].encode("latin1")
    return {"list": list, "tuple": tuple, "set": set, "frozenset": frozenset}[kind](
        inside(parts[0])
    )


def _dictionary(content: Any, path: Path) -> dict[str, Any]:
    if not isinstance(content, dict):
        raise ArtifactError(f"{path} holds a {type(content).__name__}, wanted a dictionary")
    if not all(isinstance(key, str | int) for key in content):
        raise ArtifactError(f"{path} holds a dictionary whose keys are not all words")
    return {str(key): _plain(value, f"{path}: {key}") for key, value in content.items()}


def _plain(value: Any, where: str) -> Any:
    """Turn records of known meaning into arrays."""
    if not isinstance(value, Record):
        return value
    try:
        return _array_of_record(value)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise ArtifactError(f"{where}: a damaged {value.name}: {error!r}") from None


def _array_of_record(record: Record) -> Any:
    state = record.state
    if record.name == "chumpy.Ch":
        return np.asarray(state["x"])
    if record.name == "chumpy.Select":
        source = state["a"]
        flat = np.ravel(_array_of_record(source) if isinstance(source, Record) else source)
        return flat[np.asarray(state["idxs"])].reshape(state["preferred_shape"])
    if record.name.startswith("scipy."):
        shape = state["_shape"] if "_shape" in state else state["shape"]
        kind = sparse.csc_array if record.name.startswith("scipy.csc") else sparse.csr_array
        matrix = kind((state["data"], state["indices"], state["indptr"]), shape=shape)
        if math.prod(matrix.shape) * matrix.dtype.itemsize > MAX_BYTES:
            raise ValueError(f"{matrix.shape} unfolds to too large an array")
        matrix.check_format(full_check=True)  # indices out of range would corrupt memory
        return matrix.toarray()
    return record
