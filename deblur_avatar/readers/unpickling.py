"""Restricted unpickling, run as a program of its own that the reader starts (`foreign_arrays`).

A pickle is a program. This one admits the few classes that data files of the field are made of and
refuses every other name before it is looked up: numpy's arrays, dtypes and scalars; scipy's sparse
matrices and chumpy's arrays, for which plain records stand in; plain containers. What a hostile
file can still do is ask for memory and time, and the process has little of both.

It reads a request from stdin (JSON) and writes an `.npz` to stdout: all arrays, and `tree`, the
JSON of everything else. What it refuses is JSON on stderr and exit code 3. It imports numpy alone.
"""

import io
import json
import pickle
import re
import resource
import sys
from collections import OrderedDict
from typing import Any

import numpy as np

REFUSED = 3  # exit code


class Refused(Exception):  # noqa: N818
    """A class or function outside the list was named, or one of the list with other arguments."""

    def __init__(self, what: str, *came: object) -> None:
        shown = [f"{c!r:.60}" if isinstance(c, str | int) else type(c).__name__ for c in came]
        super().__init__(" ".join([what, *shown]))


class Opaque:
    """Stands in for an object of a class that is known by name only; holds its pickled state."""

    name = ""

    def __init__(self, *arguments: object) -> None:
        self.state: object = {}

    def __setstate__(self, state: object) -> None:
        self.state = state if isinstance(state, dict) else {}


class Dtype:
    """Stands in for a dtype while it is read: numpy's own take any state, offsets beyond memory."""

    def __init__(self, code: str, *flags: object) -> None:
        if not isinstance(code, str) or not re.fullmatch("[<>=|]?[biufcSUOVMm?][0-9]{0,9}", code):
            raise Refused("a dtype", code)
        self.dtype = np.dtype(code)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        if any(part is not None for part in state[2:5]):
            raise ValueError("an array of records or of arrays")
        self.dtype = self.dtype.newbyteorder(state[1])


class Array(np.ndarray):
    """An array whose dtype is a `Dtype` while it is read."""

    def __setstate__(self, state: Any) -> None:
        version, shape, kind, fortran, content = state
        super().__setstate__((version, shape, kind.dtype, fortran, content))


class ArrayClass:
    """What pickles name as the class of an array; numpy's own would allocate any size."""


class Unpickler(pickle.Unpickler):
    """Knows the names of the list below and nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        """What a name stands for."""
        if (module, name) in ADMITTED:
            return ADMITTED[module, name]
        root = module.split(".")[0]
        if root == "chumpy" or (module.startswith("scipy.sparse") and name in SPARSE):
            return type("Opaque", (Opaque,), {"name": f"{root}.{name}"})
        raise Refused(f"{module}.{name}")

    def persistent_load(self, key: object) -> Any:
        """No data file has such objects."""
        raise Refused("a persistent object", key)


def _empty_array(kind: object, shape: object, code: object) -> Array:
    return Array((0,), np.int8)  # what numpy's pickles start from; the content is set afterwards


def _array_of_buffer(buffer: bytes, kind: Dtype, shape: tuple[int, ...], order: str = "C") -> Any:
    flat: Any = np.frombuffer(buffer, kind.dtype)
    return flat.reshape(shape, order="F" if order == "F" else "C")


def _scalar(kind: Dtype, content: bytes | str) -> Any:
    # Python 2's bytes arrive as text.
    buffer = content.encode("latin1") if isinstance(content, str) else content
    return np.frombuffer(buffer, kind.dtype)[0]


def _no_bytes(*content: object) -> bytes:
    if content:  # bytes(n) makes n of them; empty bytes are written so in the old protocols
        raise Refused("bytes of", content[0])
    return b""


def _reconstruct(kind: type, base: type, state: object) -> Opaque:
    if not (isinstance(kind, type) and issubclass(kind, Opaque)):
        raise Refused("the constructor of", kind)
    return kind()


def _encode(text: str, encoding: str = "latin1") -> bytes:
    if encoding not in ("latin1", "latin-1"):
        raise Refused("an encoding", encoding)
    return text.encode("latin1")


SPARSE = ("csc_matrix", "csr_matrix", "csc_array", "csr_array")
BUILTINS = ("__builtin__", "builtins")
ADMITTED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): ArrayClass,
    ("numpy", "dtype"): Dtype,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): OrderedDict,
    **{(f"numpy.{m}.multiarray", "_reconstruct"): _empty_array for m in ("core", "_core")},
    **{(f"numpy.{m}.multiarray", "scalar"): _scalar for m in ("core", "_core")},
    **{(f"numpy.{m}.numeric", "_frombuffer"): _array_of_buffer for m in ("core", "_core")},
    **{(module, "_reconstructor"): _reconstruct for module in ("copy_reg", "copyreg")},
    **{(m, kind.__name__): kind for m in BUILTINS for kind in (object, set, frozenset)},
    **{(module, "bytes"): _no_bytes for module in BUILTINS},
}


def read(path: str, form: str, wanted: list[str]) -> Any:
    """The content of one file; of an `.npz` the arrays that are wanted and there."""
    if form == "npz":
        with np.load(path, allow_pickle=False) as arrays:
            content = {key: arrays[key] for key in arrays.files if key in wanted}
        if not all(isinstance(array, np.ndarray) for array in content.values()):
            raise ValueError("a member that is no array")
        return content
    with open(path, "rb") as file:  # noqa: PTH123
        stream = io.BytesIO(file.read())
    if form == "npy":
        version = np.lib.format.read_magic(stream)
        header = np.lib.format.read_array_header_1_0, np.lib.format.read_array_header_2_0
        _, _, dtype = header[version != (1, 0)](stream)
        if not dtype.hasobject:
            stream.seek(0)
            return np.lib.format.read_array(stream, allow_pickle=False)
    content = Unpickler(stream, encoding="latin1").load()
    alone = form == "npy" and isinstance(content, np.ndarray) and content.size == 1
    return content.item() if alone else content


def written(value: Any, arrays: list[Any], known: dict[int, int]) -> Any:
    """JSON for a value: numbers and words as they are, all else a list that begins with its kind.

    Each array is put into `arrays` once, however often it is met.
    """
    if value is None or type(value) in (bool, int, float, str):
        return value

    def inside(values: Any) -> list[Any]:
        return [written(part, arrays, known) for part in values]

    if isinstance(value, np.ndarray) and value.dtype.hasobject:
        return ["objects", list(value.shape), inside(value.ravel().tolist())]
    if isinstance(value, np.ndarray | np.generic):
        if id(value) not in known:
            known[id(value)] = len(arrays)
            arrays.append(np.asarray(value))
        return ["array" if isinstance(value, np.ndarray) else "scalar", known[id(value)]]
    if isinstance(value, dict):
        return ["dict", inside(value.keys()), inside(value.values())]
    if isinstance(value, bytes):
        return ["bytes", value.decode("latin1")]
    for kind in (list, tuple, set, frozenset):
        if isinstance(value, kind):
            return [kind.__name__, inside(value)]
    state = value.state if isinstance(value, Opaque) else {}
    name = getattr(value, "name", "") or type(value).__name__
    return ["record", name, written(state, arrays, known)]


def main() -> int:
    """Answer one request; returns the exit code."""
    request = json.load(sys.stdin)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (request["memory"], request["memory"]))
    resource.setrlimit(resource.RLIMIT_CPU, (request["seconds"], request["seconds"]))
    arrays: list[Any] = []
    known: dict[int, int] = {}
    alive = []  # so that no array's identity is used again
    trees = []
    for index, path in enumerate(request["paths"]):
        try:
            alive.append(read(path, request["form"], request["wanted"]))
            trees.append(written(alive[-1], arrays, known))
        except Exception as error:
            # A damaged file can raise nearly anything from inside pickle, zipfile and numpy.
            memory = isinstance(error, MemoryError)
            refused = str(error) if isinstance(error, Refused) else None
            text = f"needs over {request['memory'] >> 20} MB" if memory else f"{error!r:.300}"
            json.dump({"index": index, "refused": refused, "damage": text}, sys.stderr)
            return REFUSED
    tree = np.frombuffer(json.dumps(trees).encode(), np.uint8)
    np.savez(sys.stdout.buffer, *arrays, tree=tree)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
