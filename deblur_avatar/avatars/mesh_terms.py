"""What a mesh is held to whatever it looks like: even vertices, alike neighbours, no folds.

Conventions. A mesh is wound alike all over. E edges, each once; pairs are faces that share an edge.
All means: a finer mesh weighs the same. S instants, V vertices, T triangles; metres.

Source: GoMAvatar (Wen et al., CVPR 2024), after PyTorch3D's mesh losses.
"""

import torch
from jaxtyping import Float, Int64
from torch import Tensor


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
    """Mean 1 - cosine of the angle between faces that share an edge; 0 without any."""
    a, b, c = vertices[:, faces].unbind(2)
    normals = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=-1, eps=1e-10)
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
