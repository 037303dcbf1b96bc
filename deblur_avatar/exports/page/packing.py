"""Packing: a header and named arrays in one text, few bytes and the same ones each time.

gzip of: the header's length (32 bits, little-endian), the header (JSON, which says where each
array lies), the arrays. An array of rows and columns is stored column by column and, of each
column, first all lowest bytes, then all second ones, because gzip finds more in bytes that are
alike. `payload.js` is the reader.
"""

import base64
import gzip
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Shaped, UInt8

TYPES = {"uint8": "u1", "uint16": "u2", "int16": "i2", "uint32": "u4", "float32": "f4"}
CELLS = 1024  # along each axis, of the curve that rows are put in order along


@dataclass(frozen=True)
class Packed:
    """An array as it is stored: value = low + step * stored, one pair a column; or as it is."""

    stored: Shaped[np.ndarray, "rows columns"]
    low: tuple[float, ...] = ()
    step: tuple[float, ...] = ()


def quantised(values: Float[np.ndarray, "rows columns"], bits: int) -> Packed:
    """Stored in so many bits between each column's smallest and largest value."""
    values = np.asarray(values, np.float64)
    low, high = values.min(0), values.max(0)
    step = np.maximum(high - low, 1e-12) / (2**bits - 1)
    stored = np.rint((values - low) / step).astype(np.uint16 if bits <= 16 else np.uint32)
    return Packed(stored, tuple(low.tolist()), tuple(step.tolist()))


def signed(values: Float[np.ndarray, "rows columns"], bits: int) -> Packed:
    """Stored in so many bits between -1 and 1, of which 0 is one."""
    most = 2 ** (bits - 1) - 1
    stored = np.rint(np.asarray(values, np.float64).clip(-1, 1) * most).astype(np.int16)
    columns = values.shape[1]
    return Packed(stored, (0.0,) * columns, (1.0 / most,) * columns)


def influences(
    weights: Float[np.ndarray, "rows joints"], most: int, bits: int
) -> tuple[Packed, Packed]:
    """The largest weights of each row, whose stored numbers sum to 2**bits exactly; their joints.

    Args:
        weights: rows sum to 1.
        most: of them a row; rows with more lose the smallest.
        bits: of the sum, at most 15.
    """
    used = min(int((weights > 0).sum(1).max()), most)
    joints = np.argsort(-weights, axis=1, kind="stable")[:, :used]
    kept = np.take_along_axis(weights, joints, axis=1).astype(np.float64)
    wanted = kept / kept.sum(1, keepdims=True) * 2**bits
    units = np.floor(wanted).astype(np.int64)
    # What rounding down left over goes to the largest remainders.
    order = np.argsort(-(wanted - units), axis=1, kind="stable")
    rank = np.argsort(order, axis=1, kind="stable")
    units += rank < (2**bits - units.sum(1, keepdims=True))
    joints = np.where(units > 0, joints, 0).astype(np.uint8)
    return Packed(units.astype(np.uint16), (0.0,) * used, (0.5**bits,) * used), Packed(joints)


def spatial_order(points: Float[np.ndarray, "rows 3"]) -> Int[np.ndarray, " rows"]:
    """An order in which neighbours in space are mostly neighbours: Morton's curve."""
    low, high = points.min(0), points.max(0)
    cells = ((points - low) / np.maximum(high - low, 1e-12) * (CELLS - 1)).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(CELLS.bit_length() - 1):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def packed_text(header: Mapping[str, Any], arrays: Mapping[str, Packed]) -> str:
    """All of it as base64."""
    places: dict[str, dict[str, Any]] = {}
    blocks: list[bytes] = []
    offset = 0
    for name, array in arrays.items():
        rows, columns = array.stored.shape
        places[name] = {
            "type": TYPES[array.stored.dtype.name], "offset": offset, "rows": rows,
            "columns": columns,
        } | ({"low": array.low, "step": array.step} if array.step else {})  # fmt: skip
        blocks.append(_planes(array.stored).tobytes())
        offset += len(blocks[-1])
    text = json.dumps({**header, "arrays": places}, separators=(",", ":")).encode()
    content = len(text).to_bytes(4, "little") + text + b"".join(blocks)
    # Without a time, so that equal avatars are equal bytes.
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()


def _planes(array: Shaped[np.ndarray, "rows columns"]) -> UInt8[np.ndarray, "columns bytes rows"]:
    little = array.T.astype(array.dtype.newbyteorder("<"), order="C")
    return little.view(np.uint8).reshape(*little.shape, -1).transpose(0, 2, 1).copy()
