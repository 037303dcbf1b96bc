"""What a mesh is held to whatever it looks like: even vertices, alike neighbours, no folds.

Conventions. A mesh is wound alike all over. E edges, each once; pairs are faces that share an edge.
All means: a finer mesh weighs the same. S instants, V vertices, T triangles; metres.

Float32 tensors on the CPU go through the native kernel of `triangle_mesh`, which finds the
gradients along with the terms.

Source: GoMAvatar (Wen et al., CVPR 2024), after PyTorch3D's mesh losses.
"""

import ctypes
from typing import Any, Final

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from deblur_avatar.avatars.native_terms import NativeTerm
from deblur_avatar.avatars.triangle_mesh import corner_lists, mesh_library, neighbour_lists
from deblur_avatar.rendering.native_build import pointers
from deblur_avatar.run import kernel_threads

SHORTEST: Final = 1e-10  # square metres, of twice a face's area; below it there is no normal


def mesh_edges(faces: Int64[Tensor, "T 3"]) -> Int64[Tensor, "E 2"]:
    """All edges of a mesh, the lower vertex first."""
    return torch.unique(_sides(faces), dim=0)


def adjacent_faces(faces: Int64[Tensor, "T 3"]) -> Int64[Tensor, "pairs 2"]:
    """Pairs of faces that share an edge; of k faces about one edge k - 1 pairs, in a chain."""
    _, edge = torch.unique(_sides(faces), dim=0, return_inverse=True)
    order = edge.argsort(stable=True)  # sides edge by edge
    face = order // 3
    same = edge[order][1:] == edge[order][:-1]
    return torch.stack([face[:-1][same], face[1:][same]], dim=1)


def laplacian(vertices: Float[Tensor, "S V 3"], edges: Int64[Tensor, "E 2"]) -> Float[Tensor, ""]:
    """Mean squared distance of vertices from the middle of their neighbours, square metres.

    A vertex without neighbours is where it should be.
    """
    library = mesh_library(vertices)
    if library is None:
        return laplacian_reference(vertices, edges)
    return _Laplacian.apply(vertices, edges, library)


def laplacian_reference(
    vertices: Float[Tensor, "S V 3"], edges: Int64[Tensor, "E 2"]
) -> Float[Tensor, ""]:
    """The same in plain torch, on any device and in any precision: the kernel's slow twin."""
    start, end = edges.unbind(1)
    counts = torch.bincount(edges.flatten(), minlength=vertices.shape[1]).to(vertices)
    apart = vertices.index_select(1, end) - vertices.index_select(1, start)
    pulls = torch.zeros_like(vertices).index_add(1, start, apart).index_add(1, end, -apart)
    return (pulls / counts.clamp(min=1)[:, None]).square().sum(-1).mean()


def normal_consistency(
    vertices: Float[Tensor, "S V 3"],
    faces: Int64[Tensor, "T 3"],
    pairs: Int64[Tensor, "pairs 2"],
) -> Float[Tensor, ""]:
    """Mean 1 - cosine of the angle between faces that share an edge; 0 without any.

    A face without area is at right angles to all, and has no gradient.
    """
    library = mesh_library(vertices)
    if library is None:
        return normal_consistency_reference(vertices, faces, pairs)
    return _NormalConsistency.apply(vertices, faces, pairs, library)


def normal_consistency_reference(
    vertices: Float[Tensor, "S V 3"],
    faces: Int64[Tensor, "T 3"],
    pairs: Int64[Tensor, "pairs 2"],
) -> Float[Tensor, ""]:
    """The same in plain torch, on any device and in any precision: the kernel's slow twin."""
    a, b, c = vertices[:, faces].unbind(2)
    normals = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=-1, eps=SHORTEST)
    first, second = (normals.index_select(1, side) for side in pairs.unbind(1))
    cosines = (first * second).sum(-1)
    return (1 - cosines).sum() / max(1, cosines.numel())


def color_consistency(
    colors: Float[Tensor, "T C"], pairs: Int64[Tensor, "pairs 2"]
) -> Float[Tensor, ""]:
    """Mean absolute difference of the colours of faces that share an edge; 0 without any."""
    apart = (colors[pairs[:, 0]] - colors[pairs[:, 1]]).abs()
    return apart.sum() / max(1, apart.numel())


def _sides(faces: Int64[Tensor, "T 3"]) -> Int64[Tensor, "sides 2"]:
    """The three sides of each face, face by face, the lower vertex first."""
    return torch.stack([faces, faces.roll(-1, 1)], dim=2).flatten(0, 1).sort(1).values


class _Laplacian(NativeTerm):
    @staticmethod
    def forward(ctx: Any, vertices: Tensor, edges: Tensor, library: ctypes.CDLL) -> Tensor:
        vertices = vertices.contiguous()
        count = vertices.shape[1]
        pulls, loss = torch.empty_like(vertices), vertices.new_empty(())
        grad = torch.empty_like(vertices) if ctx.needs_input_grad[0] else None
        library.laplacian(
            len(vertices), count, kernel_threads(),
            *pointers(vertices, *neighbour_lists(edges, count), pulls, loss, grad),
        )  # fmt: skip
        ctx.save_for_backward(grad)
        return loss


class _NormalConsistency(NativeTerm):
    @staticmethod
    def forward(
        ctx: Any, vertices: Tensor, faces: Tensor, pairs: Tensor, library: ctypes.CDLL
    ) -> Tensor:
        vertices, faces = vertices.contiguous(), faces.contiguous()
        instants, count, faces_count = *vertices.shape[:2], len(faces)
        room = [vertices.new_empty(instants, faces_count, width) for width in (3, 1, 9)]
        loss = vertices.new_empty(())
        grad = torch.empty_like(vertices) if ctx.needs_input_grad[0] else None
        library.normal_consistency(
            instants, count, faces_count, kernel_threads(), SHORTEST,
            *pointers(vertices, faces, *neighbour_lists(pairs, faces_count)),
            *pointers(*corner_lists(faces, count), *room, loss, grad),
        )  # fmt: skip
        ctx.save_for_backward(grad)
        return loss
