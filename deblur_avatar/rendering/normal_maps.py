"""Normal maps: which way a mesh faces in each pixel of a camera, at several instants at once.

Conventions. Cameras as in `geometry.cameras`; pixels are seen through their middles. Normals are
those of the vertices, interpolated. What a pixel sees is looked up without gradient; normals have
one. S instants, P vertices, T triangles.

A depth buffer in native code finds what lies before a pixel; without a compiler rays do, twenty
times slower, since each instant's mesh is sorted into boxes first.
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from deblur_avatar.geometry.cameras import MINIMUM_DEPTH, Camera
from deblur_avatar.rendering.mesh_rendering import View, cast_rays
from deblur_avatar.rendering.native_build import library_or_none, pointers

KERNEL: Final = Path(__file__).with_name("normal_maps.cpp")


class Places(NamedTuple):
    """Where on a mesh pixels look: (1 - u - v) a + u b + v c of triangle abc; -1 for nowhere."""

    triangle: Tensor  # int32 [H, W]
    u: Tensor  # float32 [H, W]
    v: Tensor


def seen_normals(
    vertices: Float[Tensor, "S P 3"],
    normals: Float[Tensor, "S P 3"],
    faces: Int64[Tensor, "T 3"],
    camera: Camera,
    asked: Bool[Tensor, "S H W"],
) -> tuple[Bool[Tensor, "S H W"], Float[Tensor, "met 3"]]:
    """Which pixels show a mesh, and the unit normals that these see, in the camera's axes.

    Args:
        vertices: world positions at each instant, metres; no gradient flows to them.
        normals: of the vertices, unit, in the world; differentiable.
        faces: triangles.
        camera: who looks.
        asked: pixels that are asked for.

    Returns:
        Pixels of those asked for, and their normals, instant by instant and row by row.
    """
    places = [seen_places(posed, faces, camera) for posed in vertices.detach().cpu()]
    triangle, u, v = (
        torch.stack(values).to(normals.device) for values in zip(*places, strict=True)
    )
    met = asked & (triangle >= 0)
    corners = faces[triangle[met].long()]
    # Rows of all instants' normals, one after the other.
    corners = corners + normals.shape[1] * met.nonzero()[:, :1]
    u, v = u[met].to(normals), v[met].to(normals)
    shares = torch.stack([1 - u - v, u, v], dim=1)
    seen = (shares[..., None] * normals.flatten(0, 1)[corners]).sum(1)
    turned = torch.nn.functional.normalize(seen, dim=-1) @ camera.viewmat[:3, :3].T.to(normals)
    return met, turned


def seen_places(
    vertices: Float[Tensor, "P 3"], faces: Int64[Tensor, "T 3"], camera: Camera
) -> Places:
    """Where on a mesh each pixel's middle looks.

    Args:
        vertices: world positions, metres, on the CPU.
        faces: triangles.
        camera: who looks. Triangles that reach behind it may not be seen.
    """
    library = _library()
    if library is None:
        return seen_places_reference(vertices, faces, camera)
    vertices, faces = vertices.float().contiguous(), faces.cpu().contiguous()
    size = camera.height, camera.width
    projection = (camera.K.double() @ camera.viewmat.double()[:3]).cpu().contiguous()
    triangle = torch.empty(size, dtype=torch.int32)
    u, v = torch.zeros(size), torch.zeros(size)
    points, depths = (
        torch.empty(shape, dtype=torch.float64) for shape in ((len(vertices), 3), size)
    )
    library.seen_places(
        len(vertices), len(faces), camera.width, camera.height, MINIMUM_DEPTH,
        *pointers(vertices, faces, projection, points, depths, triangle, u, v),
    )  # fmt: skip
    return Places(triangle, u, v)


def seen_places_reference(
    vertices: Float[Tensor, "P 3"], faces: Int64[Tensor, "T 3"], camera: Camera
) -> Places:
    """The same by a ray through each pixel's middle: the kernel's slow twin."""
    K, viewmat = (part.double().cpu().numpy() for part in (camera.K, camera.viewmat))
    view = View(K, viewmat, camera.width, camera.height, samples_per_axis=1)
    hits = cast_rays(
        vertices.numpy(), faces.cpu().numpy(), view.centre, view.directions.reshape(-1, 3)
    )
    found = (hits.triangle, hits.u, hits.v)
    return Places(
        *(torch.as_tensor(np.asarray(one)).reshape(camera.height, camera.width) for one in found)
    )


@cache
def _library() -> ctypes.CDLL | None:
    library = library_or_none(KERNEL, "Normal maps are drawn")
    if library is None:
        return None
    library.seen_places.argtypes = [
        *[ctypes.c_int64] * 4, ctypes.c_double, *[ctypes.c_void_p] * 8,
    ]  # fmt: skip
    return library
