"""glTF 2.0 binary files (`.glb`): accessors put together, then the file.

Conventions. glTF's: +Y up, metres, seconds, quaternions xyzw, matrices by columns, colours of
vertices in linear light.

Source: Khronos Group, "glTF 2.0 Specification", 2021.
"""

import json
from typing import Any

import numpy as np
from jaxtyping import Shaped

COMPONENTS = {"float32": 5126, "uint32": 5125, "uint16": 5123, "uint8": 5121}
SHAPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
VERTICES, TRIANGLES = 34962, 34963  # what a buffer's part is for
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942


class GltfFile:
    """A document that grows, and the numbers it points to."""

    def __init__(self, licence: str) -> None:
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "deblur_avatar", "copyright": licence},
            "scene": 0,
            "accessors": [],
            "bufferViews": [],
        }
        self._blocks: list[bytes] = []
        self._size = 0

    def accessor(
        self, values: Shaped[np.ndarray, "..."], *, target: int | None = None, bounds: bool = False
    ) -> int:
        """Add numbers; their index.

        Args:
            values: [N], [N, 2 to 4] or [N, 4, 4], the latter by rows.
            target: `VERTICES`, `TRIANGLES` or neither.
            bounds: say the smallest and largest value of each column, as positions and times must.
        """
        values = np.ascontiguousarray(values)
        said: dict[str, Any] = {
            "bufferView": len(self.document["bufferViews"]),
            "componentType": COMPONENTS[values.dtype.name],
            "count": len(values),
            "type": SHAPES[values.shape[1:]],
        }
        if bounds:
            flat = values.reshape(len(values), -1)
            said |= {"min": flat.min(0).tolist(), "max": flat.max(0).tolist()}
        stored = values.swapaxes(1, 2) if values.ndim == 3 else values
        block = np.ascontiguousarray(stored).tobytes()
        view = {"buffer": 0, "byteOffset": self._size, "byteLength": len(block)}
        self.document["bufferViews"].append(view | ({"target": target} if target else {}))
        self._blocks.append(block + bytes(-len(block) % 4))
        self._size += len(self._blocks[-1])
        self.document["accessors"].append(said)
        return len(self.document["accessors"]) - 1

    def content(self) -> bytes:
        """The whole file."""
        document = {**self.document, "buffers": [{"byteLength": self._size}]}
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = ((JSON_CHUNK, text), (BINARY_CHUNK, b"".join(self._blocks)))
        body = b"".join(_words(len(block), kind) + block for kind, block in chunks)
        return b"glTF" + _words(2, 12 + len(body)) + body


def _words(*numbers: int) -> bytes:
    return np.array(numbers, "<u4").tobytes()
