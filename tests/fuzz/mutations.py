"""How a good file becomes a hostile one.

Bytes are flipped, cut, moved, or replaced by numbers that sizes should not be; text has its words
replaced; files that hold values (JSON, npz, npy, pickles, safetensors) are taken apart, changed at
one place or more, and put together again, so that the harm is inside of a sound file.
"""

import contextlib
import copy
import io
import json
import pickle
import re
import struct
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from hypothesis import strategies as st

SIZES = (0, 1, 2, 127, 128, 255, 256, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 10**13)
WORDS = (
    b"nan", b"inf", b"-inf", b"1e309", b"1e39", b"1e300", b"5e-324", b"-1", b"0", b"9" * 5000,
    b"10000000000000", b"\xc2\xb2", b"\xd9\xa3", b"1_0", b"0x10", b"", b"\x00", b"\xff\xfe",
    b"null", b"true", b"[]", b"{}", b'"', b"[" * 2000, b"../" * 9 + b"etc/passwd", b"\\ud800",
    "\u202e\u00e9\U0001f600".encode(), b"%s%n", b"<!---->", b"&x;", b"*x",
    b"!!python/name:os.system",
)  # fmt: skip
TEXT = (".json", ".yaml", ".toml", ".txt", ".bvh")


def _nested(depth: int) -> Any:
    value: Any = 1.0
    for _ in range(depth):
        value = [value]
    return value


SCALARS: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 2**31, 2**63, -(2**63) - 1, 10**400, 0.5, 1e39, 1e300, 5e-324,
    float("nan"), float("inf"), float("-inf"), "", "x", "0", "1e5", "\u00b2", "\x00", "\ud800",
    "../../../etc/passwd", "/dev/zero", "x" * 3000, "9" * 5000, "camera_" + "1" * 5000 + ".jpg",
)  # fmt: skip
CONTAINERS: tuple[Callable[[], Any], ...] = (
    list, dict, lambda: [[]], lambda: {"": None}, lambda: _nested(70), lambda: [1, [2, [3]]],
    lambda: [{}] * 3, lambda: {"schema": 1, "images": [-1]}, lambda: [1e300] * 3, lambda: ["1"] * 3,
)  # fmt: skip
# What JSON cannot say and pickles and arrays can.
OBJECTS: tuple[Callable[[], Any], ...] = (
    lambda: _nested(400), lambda: b"\xff", lambda: 1j, lambda: {1, 2},
    lambda: (1, (2,)), lambda: np.float64("nan"), lambda: np.zeros(3), lambda: np.array("x"),
    lambda: np.array([None, 1]), lambda: np.array(1 + 2j), lambda: {(1, 2): 3, None: 4},
    lambda: np.zeros((2, 0)), lambda: np.array([b"\xff"]), lambda: np.longdouble("1e400"),
)  # fmt: skip
DTYPES = (
    "f2", "f4", "f8", "g", "c16", "i1", "u1", "i8", "u8", "?", "S4", "U4", "M8[s]", "m8[s]", "O",
    ">f4", ">i8",
)  # fmt: skip


@st.composite
def hostile(draw: st.DrawFn, content: bytes, suffix: str) -> bytes:
    """A damaged or malicious version of a file's content."""
    families: list[Callable[[st.DrawFn, bytes], bytes]] = [_noise, _cut, _flip, _splice, _resize]
    if suffix in TEXT:
        families += [_word, _word, _lines]
    if suffix in CODECS:
        families += [partial(_value, suffix=suffix)] * 5
    return draw(st.sampled_from(families))(draw, content)


# --- bytes --------------------------------------------------------------------------------------


def _place(draw: st.DrawFn, content: bytes) -> int:
    """Somewhere, and as often as not in the first bytes, where most formats keep their sizes."""
    last = max(len(content) - 1, 0)
    return draw(st.one_of(st.integers(0, last), st.integers(0, min(last, 64))))


def _noise(draw: st.DrawFn, content: bytes) -> bytes:
    kept = draw(st.sampled_from((0, 2, 4, 8, 16, 64)))
    return content[:kept] + draw(st.binary(max_size=100))


def _cut(draw: st.DrawFn, content: bytes) -> bytes:
    return content[: _place(draw, content)]


def _flip(draw: st.DrawFn, content: bytes) -> bytes:
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 8))):
        if changed:
            changed[_place(draw, content)] ^= 1 << draw(st.integers(0, 7))
    return bytes(changed)


def _splice(draw: st.DrawFn, content: bytes) -> bytes:
    first, second, to = sorted(_place(draw, content) for _ in range(3))
    piece = content[first:second] * draw(st.sampled_from((0, 1, 2, 20)))
    return draw(st.sampled_from((content[:to] + piece + content[to:], piece + content[second:])))


def _resize(draw: st.DrawFn, content: bytes) -> bytes:
    """A number of 1 to 8 bytes becomes one that a size may not be."""
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 2))):
        place, width = _place(draw, content), draw(st.sampled_from((1, 2, 4, 8)))
        size = draw(st.sampled_from(SIZES)) % 2 ** (8 * width)
        changed[place : place + width] = size.to_bytes(
            width, draw(st.sampled_from(("big", "little")))
        )
    return bytes(changed)


# --- text ---------------------------------------------------------------------------------------


def _word(draw: st.DrawFn, content: bytes) -> bytes:
    for _ in range(draw(st.integers(1, 3))):
        words = list(re.finditer(rb"[\w.+-]+", content))
        if not words:
            break
        word = draw(st.sampled_from(words))
        new = draw(st.sampled_from((*WORDS, draw(st.sampled_from(words))[0])))
        content = content[: word.start()] + new + content[word.end() :]
    return content


def _lines(draw: st.DrawFn, content: bytes) -> bytes:
    lines = content.splitlines(keepends=True)
    for _ in range(draw(st.integers(1, 3))):
        if not lines:
            break
        at, to = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
        action = draw(st.sampled_from(("drop", "repeat", "swap")))
        if action == "drop":
            del lines[at]
        elif action == "repeat":
            lines[at:at] = [lines[to]] * draw(st.sampled_from((1, 2, 50)))
        else:
            lines[at], lines[to] = lines[to], lines[at]
    return b"".join(lines)


# --- values -------------------------------------------------------------------------------------


def _value(draw: st.DrawFn, content: bytes, suffix: str) -> bytes:
    read, write = CODECS[suffix]
    tree = copy.deepcopy(read(content))
    for _ in range(draw(st.sampled_from((1, 1, 1, 2, 3)))):
        tree = _changed(draw, tree)
    # What a format cannot say at all is no hostile file of that format.
    with contextlib.suppress(TypeError, ValueError, ArithmeticError, RecursionError, LookupError):
        return write(tree, draw)
    return content[:-1]


def _places(tree: Any) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    items = tree.items() if isinstance(tree, dict) else ()
    items = enumerate(tree) if isinstance(tree, list) else items
    for key, value in list(items)[:50]:
        found += [(tree, key), *_places(value)]
    return found


def _changed(draw: st.DrawFn, tree: Any) -> Any:
    places = _places(tree)
    if not places or draw(st.integers(0, 30)) == 0:
        return _replacement(draw, tree)
    parent, key = draw(st.sampled_from(places))
    action = draw(st.sampled_from(("replace", "replace", "replace", "drop", "swap", "rename")))
    if action == "drop":
        del parent[key]
    elif action == "swap":
        other, at = draw(st.sampled_from(places))
        parent[key], other[at] = copy.deepcopy(other[at]), copy.deepcopy(parent[key])
    elif action == "rename" and isinstance(parent, dict):
        parent[draw(st.sampled_from(("", "x", "\ud800", "a.b", "schema", "../x", "9" * 300)))] = (
            parent.pop(key)
        )
    else:
        parent[key] = _replacement(draw, parent[key])
    return tree


def _replacement(draw: st.DrawFn, value: Any) -> Any:
    if isinstance(value, np.ndarray) and draw(st.integers(0, 4)):
        return _array(draw, value)
    kind = draw(st.integers(0, 5))
    if kind == 0:
        return draw(st.sampled_from(CONTAINERS))()
    if kind == 1:
        return draw(st.sampled_from(OBJECTS))()
    return draw(st.sampled_from(SCALARS))


def _array(draw: st.DrawFn, value: np.ndarray) -> Any:
    action = draw(st.sampled_from(("dtype", "shape", "fill", "one")))
    if action == "dtype":
        with np.errstate(all="ignore"), contextlib.suppress(TypeError, ValueError):
            return value.astype(draw(st.sampled_from(DTYPES)))
        return np.zeros(value.shape, [("a", "f8"), ("b", "O")])
    if action == "shape":
        row = np.atleast_1d(value)  # a single number cannot be cut
        shapes = (
            value.ravel(), value[None], value[..., None], value.T, row[:0], row[:1],
            row[..., :0],
            value.ravel()[:1].reshape(()) if value.size else value, np.repeat(value[None], 3, 0),
            value.ravel()[:1].reshape((1,) * 20) if value.size else value,
        )  # fmt: skip
        return draw(st.sampled_from(shapes))
    if value.dtype.kind not in "fiu":
        return value[..., None]
    bad = draw(st.sampled_from((np.nan, np.inf, -np.inf, 1e300, 1e39, -1.0, 0.0, 5e-324, 1e19)))
    with np.errstate(all="ignore"):
        changed = np.array(value, np.float64 if value.dtype.kind == "f" else value.dtype)
        if action == "fill" or not value.size:
            return np.full(value.shape, bad).astype(changed.dtype)
        changed.ravel()[draw(st.integers(0, value.size - 1))] = np.asarray(bad).astype(
            changed.dtype
        )
        return changed


# --- formats that hold values: taken apart, and put together again --------------------------------


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic | set | tuple):
        return list(np.asarray(value).ravel()) if isinstance(value, np.ndarray) else None
    return value


def _json_text(tree: Any, draw: st.DrawFn) -> bytes:
    text = json.dumps(tree, default=_plain)
    if isinstance(tree, dict) and tree and draw(st.integers(0, 9)) == 0:
        text = text[:-1] + f", {json.dumps(next(iter(tree)))}: 1}}"  # a key that is there twice
    return text.encode("utf-8", "surrogatepass")


def _npz_arrays(content: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(content), allow_pickle=True) as arrays:
        return dict(arrays)


def _npz_bytes(tree: Any, draw: st.DrawFn) -> bytes:
    stream = io.BytesIO()
    tree = tree if isinstance(tree, dict) else {"arr": tree}
    saved = np.savez_compressed if draw(st.booleans()) else np.savez
    saved(stream, **{str(key): value for key, value in tree.items()})
    return stream.getvalue()


def _npy_value(content: bytes) -> Any:
    value = np.load(io.BytesIO(content), allow_pickle=True)
    return value.item() if value.dtype == object else [value]


def _npy_bytes(tree: Any, draw: st.DrawFn) -> bytes:
    stream = io.BytesIO()
    single = isinstance(tree, list) and len(tree) == 1
    np.save(stream, tree[0] if single else np.array(tree, object))
    return stream.getvalue()


def _pickle_bytes(tree: Any, draw: st.DrawFn) -> bytes:
    return pickle.dumps(tree, draw(st.integers(0, pickle.HIGHEST_PROTOCOL)))


def _safetensors_parts(content: bytes) -> Any:
    size = int.from_bytes(content[:8], "little")
    return {"header": json.loads(content[8 : 8 + size]), "data": [content[8 + size :].hex()]}


def _safetensors_bytes(tree: Any, draw: st.DrawFn) -> bytes:
    header = json.dumps(tree["header"], default=_plain).encode("utf-8", "surrogatepass")
    data = bytes.fromhex(tree["data"][0])
    return struct.pack("<Q", len(header)) + header + data


CODECS: dict[str, tuple[Callable[[bytes], Any], Callable[[Any, st.DrawFn], bytes]]] = {
    ".json": (json.loads, _json_text),
    ".yaml": (json.loads, _json_text),  # written as JSON, which YAML understands
    ".npz": (_npz_arrays, _npz_bytes),
    ".npy": (_npy_value, _npy_bytes),
    ".pkl": (pickle.loads, _pickle_bytes),
    ".safetensors": (_safetensors_parts, _safetensors_bytes),
}
