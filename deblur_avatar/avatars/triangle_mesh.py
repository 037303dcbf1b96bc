"""The native kernel of posed triangle meshes, and the lists of neighbours that it walks.

Conventions. V vertices, N faces [N, 3] of them; corners count face by face, three each. A *list* is
what each row has, its corners or its neighbours, in ascending order of where they are met.

In plain torch a mesh is many short calls over gathered corners, whose gradients are scattered one
by one: at 27,000 faces most of a fitting step (docs/decisions/0039-gomavatar.md).
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

import torch
from jaxtyping import Int32, Int64
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from deblur_avatar.rendering.native_build import library_or_none

KERNEL: Final = Path(__file__).with_name("triangle_mesh.cpp")

# Of what float32 still knows of faces of a centimetre; the kernel is compiled with them.
ROUND: Final = 1e-4  # of a face's size; an ellipse this near to a circle has no longer axis
FLAT: Final = 1e-12  # square metres; a face this small has no normal

# Lists that are still needed by someone, how many rows they have, and what version of faces or
# pairs they are of.
_KNOWN: Final = WeakTensorKeyDictionary()


class Lists(NamedTuple):
    """Row r has items[starts[r]] up to items[starts[r + 1]]."""

    starts: Int32[Tensor, " rows1"]
    items: Int32[Tensor, " items"]


def mesh_library(*values: Tensor) -> ctypes.CDLL | None:
    """The kernel, for float32 tensors on the CPU and where there is a compiler; else None."""
    alike = all(one.device.type == "cpu" and one.dtype == torch.float32 for one in values)
    return _library() if alike else None


def corner_lists(faces: Int64[Tensor, "N 3"], vertices: int) -> Lists:
    """The corners of each of the vertices.

    Raises:
        IndexError: if a face has a vertex that there is not.
    """
    return _remembered(faces, faces.flatten(), torch.arange(faces.numel()), vertices)


def neighbour_lists(pairs: Int64[Tensor, "pairs 2"], count: int) -> Lists:
    """The other ends of each one's pairs, of so many vertices or faces.

    Raises:
        IndexError: if a pair has an end that there is not.
    """
    return _remembered(pairs, pairs.T.flatten(), pairs.flip(1).T.flatten(), count)


def _remembered(of: Tensor, rows: Tensor, items: Tensor, count: int) -> Lists:
    """Group items by their rows, once for faces or pairs that stay the same."""
    known = (of._version, count)
    found = _KNOWN.get(of)
    if found is None or found[0] != known:
        odd = rows[(rows < 0) | (rows >= count)]
        if len(odd):
            raise IndexError(f"a mesh of {count} vertices or faces has no row {int(odd[0])}")
        order = rows.argsort(stable=True)
        ends = torch.bincount(rows, minlength=count).cumsum(0)
        starts = torch.cat([ends.new_zeros(1), ends])
        found = known, Lists(starts.int(), items[order].int())
        _KNOWN[of] = found
    return found[1]


@cache
def _library() -> ctypes.CDLL | None:
    defines = [f"ROUND={ROUND}f", f"FLAT={FLAT}f"]
    library = library_or_none(KERNEL, "Meshes are posed", defines)
    if library is None:
        return None
    integer, number, pointer = ctypes.c_int64, ctypes.c_float, ctypes.c_void_p
    mesh = [integer, integer, integer, ctypes.c_int, number]  # S, V, N, threads, a length
    for name, pointers in (
        ("face_gaussians", 5),
        ("face_gaussians_backward", 10),
        ("vertex_normals", 6),
        ("vertex_normals_backward", 9),
        ("normal_consistency", 11),
    ):
        getattr(library, name).argtypes = [*mesh, *[pointer] * pointers]
    library.laplacian.argtypes = [integer, integer, ctypes.c_int, *[pointer] * 6]
    return library
