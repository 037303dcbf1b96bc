"""Normals of a mesh that moves: of its vertices, at several instants at once.

Conventions. World axes, unit length; a normal is the mean over the faces around its vertex,
weighted by their area. S instants, V vertices, N faces.

Float32 tensors on the CPU go through the native kernel of `triangle_mesh`.
"""

import ctypes
from typing import Any, Final

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable

from deblur_avatar.avatars.surface_projection import vertex_normals
from deblur_avatar.avatars.triangle_mesh import corner_lists, mesh_library
from deblur_avatar.rendering.native_build import pointers
from deblur_avatar.run import kernel_threads

SHORTEST: Final = 1e-12  # square metres, of twice the faces' areas; below it there is no direction


def posed_normals(
    vertices: Float[Tensor, "S V 3"], faces: Int64[Tensor, "N 3"]
) -> Float[Tensor, "S V 3"]:
    """Unit normals of posed vertices; 0 without a gradient where no face says which way."""
    library = mesh_library(vertices)
    if library is None:
        return torch.stack([vertex_normals(posed, faces) for posed in vertices])
    return _Normals.apply(vertices, faces, library)


class _Normals(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, vertices: Tensor, faces: Tensor, library: ctypes.CDLL) -> Tensor:
        vertices, faces = vertices.contiguous(), faces.contiguous()
        instants, count = vertices.shape[:2]
        ctx.sizes = instants, count, len(faces), kernel_threads(), SHORTEST
        ctx.lists, ctx.library = corner_lists(faces, count), library
        normals, lengths = torch.empty_like(vertices), vertices.new_empty(instants, count)
        library.vertex_normals(*ctx.sizes, *pointers(vertices, faces, *ctx.lists, normals, lengths))
        ctx.save_for_backward(vertices, faces, normals, lengths)
        return normals

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        vertices, faces, normals, lengths = ctx.saved_tensors
        corners = vertices.new_empty(len(vertices), len(faces), 9)
        found = torch.empty_like(vertices)
        ctx.library.vertex_normals_backward(
            *ctx.sizes,
            *pointers(vertices, faces, *ctx.lists, normals, lengths, grad.contiguous()),
            *pointers(corners, found),
        )
        return found, None, None
