"""Arrays from other people's pickle files, without running what those files ask to run.

A pickle is a program. This reader admits the few classes that data files of the field are made of
and refuses every other name before it is looked up, so that nothing of the file is executed:
numpy arrays, dtypes and scalars; scipy's sparse matrices and chumpy's arrays, for which plain
records stand in (neither package is imported, no code of theirs runs); plain containers. What it
makes is not much larger than the file, whose size is bounded.
"""

import io
import math
import pickle
import pickletools
import re
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from deblur_avatar.errors import ArtifactError

MAX_DEPTH, MAX_OBJECTS = 60, 10_000_000  # numpy's arrays have up to 64 dimensions
MAX_BYTES = 1 << 30  # of a file, and of an array that unfolds; SMPL's largest file has 250 MB


class Record:
    """Stands in for an object of a class that is known by name only; holds its pickled state."""

    name = ""

    def __init__(self, *arguments: object) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: object) -> None:
        self.state = dict(state) if isinstance(state, dict) else {}


class Refused(Exception):  # noqa: N818
    """A class or function outside the list was named, or one of the list with other arguments.

    Of those only words and numbers are shown: the text of containers may be longer than memory.
    """

    def __init__(self, what: str, *came: object) -> None:
        shown = [f"{c!r:.60}" if isinstance(c, str | int) else type(c).__name__ for c in came]
        super().__init__(" ".join([what, *shown]))


def load_arrays(path: Path) -> dict[str, Any]:
    """Read a pickled dictionary, written by Python 2 or 3.

    Arrays come as numpy arrays, sparse matrices and chumpy arrays too. A chumpy expression whose
    value would have to be computed stays a `Record`.

    Raises:
        ArtifactError: if the file is missing, damaged, too large, not a dictionary, or names a
            class that is not on the list; nothing of it has been executed then.
    """
    return _dictionary(_read(Path(path), _unpickled), path)


def load_npy(path: Path) -> NDArray[Any] | dict[str, Any]:
    """Read a `.npy` file: an array of numbers, or the dictionary that was saved as one of objects.

    Raises:
        ArtifactError: as `load_arrays`, and for arrays of other objects.
    """
    content = _read(Path(path), _npy_content)
    if isinstance(content, np.ndarray) and not content.dtype.hasobject:
        return content
    if isinstance(content, np.ndarray) and content.size == 1:
        content = content.item()
    return _dictionary(content, path)


def _read(path: Path, reader: Callable[[io.BufferedIOBase], Any]) -> Any:
    remedy = "Take the file from its publisher, or save it again as .npz"
    with readable(path, "no data file needs", remedy):
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise ArtifactError(
                f"{path} has {size >> 20} MB, at most {MAX_BYTES >> 20} MB are read; "
                "is it the file it should be?"
            )
        # From memory, which has no more bytes than there are, whatever the file claims.
        return reader(io.BytesIO(path.read_bytes()))


@contextmanager
def readable(path: Path, unneeded: str, remedy: str) -> Iterator[None]:
    """Turn whatever reading a file raises into an error that names it.

    Args:
        path: what is read.
        unneeded: "no data file needs", say, which follows what the file wants to run.
        remedy: what to do with a file that wants to run something.

    Raises:
        ArtifactError: as it came, or for a file that is missing, damaged, or names anything that is
            not on the list.
    """
    try:
        yield
    except ArtifactError:
        raise
    except OSError as error:
        raise ArtifactError(f"cannot read {path}: {error.strerror or error}") from None
    except Refused as error:
        raise ArtifactError(
            f"{path} wants to run {error}, which {unneeded}; nothing was executed. {remedy}"
        ) from None
    except Exception as error:
        # A damaged file can raise nearly anything from inside pickle, zipfile and torch.
        raise ArtifactError(
            f"{path} is not a readable {path.suffix or 'data'} file: {error!r}"
        ) from None


def check_structure(file: io.BufferedIOBase) -> None:
    """Walk over a pickle without making anything of it; the file is left after it.

    Python would hash a tuple in a tuple in a tuple until its own stack ends, and the process with
    it, or, where each is in the next one twice, until the end of days.

    Raises:
        ValueError: if objects are nested over `MAX_DEPTH` levels deep or numbered far apart, or if
            the keys among them unfold to over `MAX_OBJECTS` objects.
    """
    stack: list[_Outline | None] = []
    memo: dict[int, _Outline] = {}
    hashed = 0
    for count, (operation, argument, _) in enumerate(pickletools.genops(cast("IO[bytes]", file))):
        hashed += _follow(operation, argument, stack, memo)
        if hashed > MAX_OBJECTS:
            raise ValueError(f"its keys unfold to over {MAX_OBJECTS} objects")
        # Python's memo is a list: one far index would allocate everything before it.
        if operation.name in ("PUT", "BINPUT", "LONG_BINPUT") and int(argument or 0) > count + 1:
            raise ValueError(f"an object is numbered {argument} among {count}")


def _unpickled(file: io.BufferedIOBase) -> Any:
    begin = file.tell()
    check_structure(file)
    file.seek(begin)
    return _RestrictedUnpickler(file, encoding="latin1").load()


@dataclass(slots=True)
class _Outline:
    """What is known of an object that was not made: how deep it is, and how much it unfolds to."""

    depth: int = 0
    count: int = 1


def _follow(
    operation: pickletools.OpcodeInfo,
    argument: Any,
    stack: list[_Outline | None],
    memo: dict[int, _Outline],
) -> int:
    """Do to outlines what the operation does to objects; None on the stack is a mark.

    Returns:
        How many objects are hashed on the way.
    """
    name, before = operation.name, operation.stack_before
    if name == "MARK":
        stack.append(None)
        return 0
    if "PUT" in name or name == "MEMOIZE":
        memo[len(memo) if name == "MEMOIZE" else int(argument)] = stack[-1] or _Outline()
        return 0
    if name.endswith("GET"):
        stack.append(memo.get(int(argument)) or _Outline())
        return 0
    inside = []
    if pickletools.markobject in before:
        while (outline := stack.pop()) is not None:
            inside.append(outline)
        below = before.index(pickletools.markobject)
    else:
        below = len(before)
    inside += [stack.pop() or _Outline() for _ in range(below)]
    # What comes into a container, and that; everything else is made anew.
    itself = inside.pop() if name in _CHANGES else _Outline()
    itself.depth = max(itself.depth, 1 + max((part.depth for part in inside), default=-1))
    itself.count += sum(part.count for part in inside)
    if itself.depth > MAX_DEPTH:
        raise ValueError(f"objects are nested over {MAX_DEPTH} levels deep")
    stack += [itself] * len(operation.stack_after)
    keys = inside[1::2] if name in _PAIRS else inside if name in _HASHES else ()
    return sum(key.count for key in keys)


_PAIRS = ("SETITEM", "SETITEMS", "DICT")  # values come off the stack before their keys
_HASHES = ("ADDITEMS", "FROZENSET", "REDUCE", "NEWOBJ", "NEWOBJ_EX", "OBJ", "INST")
_CHANGES = ("APPEND", "APPENDS", "SETITEM", "SETITEMS", "ADDITEMS", "BUILD")


def _npy_content(file: io.BufferedIOBase) -> Any:
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(file)
    if dtype.hasobject:
        return _unpickled(file)
    rest = len(file.read())
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > rest:
        raise ValueError(f"an array of shape {shape!s:.60} does not fit into {rest} bytes")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def _dictionary(content: Any, path: Path) -> dict[str, Any]:
    if not isinstance(content, dict):
        kind = "ndarray" if isinstance(content, np.ndarray) else type(content).__name__
        raise ArtifactError(f"{path} holds a {kind}, wanted a dictionary")
    if not all(isinstance(key, str | int) for key in content):
        raise ArtifactError(f"{path} holds a dictionary whose keys are not all words")
    try:
        _unfolded(content, {}, 0)
    except ValueError as error:
        raise ArtifactError(f"{path} is not a readable file: {error}") from None
    return {str(key): _plain(value, f"{path}: {key}") for key, value in content.items()}


def _unfolded(value: Any, known: dict[int, int | None], depth: int) -> int:
    """How many objects one stands for where others are in it more than once."""
    parts: Iterable[Any] = ()
    if isinstance(value, dict):
        parts = value.values()
    elif isinstance(value, list | tuple | set | frozenset):
        parts = value
    elif isinstance(value, Record):
        parts = value.state.values()
    elif isinstance(value, np.ndarray) and value.dtype.hasobject:
        parts = value.ravel().tolist()
    if not parts:
        return 1
    if id(value) not in known:
        if depth > MAX_DEPTH:
            raise ValueError(f"objects are nested over {MAX_DEPTH} levels deep")
        known[id(value)] = None
        known[id(value)] = 1 + sum(_unfolded(part, known, depth + 1) for part in parts)
    count = known[id(value)]
    if count is None:
        raise ValueError("an object holds itself")
    if count > MAX_OBJECTS:
        raise ValueError(f"it unfolds to over {MAX_OBJECTS} objects")
    return count


class _RestrictedUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _ADMITTED:
            return _ADMITTED[module, name]
        root = module.split(".")[0]
        if root == "chumpy" or (module.startswith("scipy.sparse") and name in _SPARSE):
            return _record_class(f"{root}.{name}")
        raise Refused(f"{module}.{name}")

    def persistent_load(self, key: object) -> Any:
        raise Refused("a persistent object", key)


@lru_cache(maxsize=100)  # a class takes 1 kB, its name in a file a few bytes
def _record_class(name: str) -> type[Record]:
    return type("Record", (Record,), {"name": name})


class _Kind:
    """Stands in for a dtype while it is read: numpy's own take any state, offsets beyond memory."""

    def __init__(self, code: str, *flags: object) -> None:
        if not isinstance(code, str) or not re.fullmatch("[<>=|]?[biufcSUOVMm?][0-9]{0,9}", code):
            raise Refused("a dtype", code)
        self.dtype = np.dtype(code)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        if any(part is not None for part in state[2:5]):
            raise ValueError("an array of records or of arrays")
        self.dtype = self.dtype.newbyteorder(state[1])


class _Array(np.ndarray):
    """An array whose dtype is a `_Kind`."""

    def __setstate__(self, state: Any) -> None:
        version, shape, kind, fortran, content = state
        super().__setstate__((version, shape, kind.dtype, fortran, content))


def _empty_array(kind: object, shape: object, code: object) -> NDArray[Any]:
    """What numpy's pickles start from; the content is set afterwards."""
    return _Array((0,), np.int8)


def _array_of_buffer(
    buffer: bytes, kind: _Kind, shape: tuple[int, ...], order: str = "C"
) -> NDArray[Any]:
    """What numpy's pickles of protocol 5 call; numpy itself refuses to make objects of bytes."""
    flat: NDArray[Any] = np.frombuffer(buffer, kind.dtype)
    return flat.reshape(shape, order="F" if order == "F" else "C")


def _no_bytes(*content: object) -> bytes:
    """How Python 3 writes empty bytes in the old protocols; of a number, bytes() makes as many."""
    if content:
        raise Refused("bytes of", content[0])
    return b""


class _ArrayKind:
    """What numpy's pickles name as the class of an array; numpy's own would allocate any size."""


def _scalar(kind: _Kind, content: bytes | str) -> Any:
    # Python 2's bytes arrive as text.
    buffer = content.encode("latin1") if isinstance(content, str) else content
    return np.frombuffer(buffer, kind.dtype)[0]


def _reconstruct(kind: type, base: type, state: object) -> Record:
    """What Python 2 wrote for an instance; only records may be made so."""
    if not (isinstance(kind, type) and issubclass(kind, Record)):
        raise Refused("the constructor of", kind)
    return kind()


def _encode(text: str, encoding: str = "latin1") -> bytes:
    """How Python 3 writes bytes in the old protocols."""
    if encoding not in ("latin1", "latin-1"):
        raise Refused("an encoding", encoding)
    return text.encode("latin1")


_SPARSE = ("csc_matrix", "csr_matrix", "csc_array", "csr_array")
_NUMPY = ("numpy.core.multiarray", "numpy._core.multiarray")
_NUMERIC = ("numpy.core.numeric", "numpy._core.numeric")
_ADMITTED: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): _ArrayKind,
    ("numpy", "dtype"): _Kind,
    **{(module, "_reconstruct"): _empty_array for module in _NUMPY},
    **{(module, "scalar"): _scalar for module in _NUMPY},
    **{(module, "_frombuffer"): _array_of_buffer for module in _NUMERIC},
    ("copy_reg", "_reconstructor"): _reconstruct,
    ("copyreg", "_reconstructor"): _reconstruct,
    ("_codecs", "encode"): _encode,
    ("collections", "OrderedDict"): OrderedDict,
    **{
        (module, kind.__name__): kind
        for module in ("__builtin__", "builtins")
        for kind in (object, set, frozenset)
    },
    **{(module, "bytes"): _no_bytes for module in ("__builtin__", "builtins")},
}


def _plain(value: Any, where: str) -> Any:
    """Turn records of known meaning into arrays."""
    if not isinstance(value, Record):
        return value
    try:
        return _array_of_record(value)
    except (KeyError, TypeError, ValueError, IndexError) as error:
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
