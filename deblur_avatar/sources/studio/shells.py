"""Mesh editing: cutting, refining and smoothing, by which garments are made from a body's surface.

Conventions. Metres. A mesh is made from another by mixing its vertices: new vertex k is
(1 - share[k]) old[first[k]] + share[k] old[second[k]], which serves positions, normals and skinning
weights alike.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix, csr_matrix, diags

from deblur_avatar.rendering.mesh_rendering import face_normals, unit


@dataclass(frozen=True)
class Mixture:
    """A mesh whose vertices are mixtures of two vertices of another."""

    first: Int[np.ndarray, " P"]
    second: Int[np.ndarray, " P"]
    share: Float[np.ndarray, " P"]
    faces: Int[np.ndarray, "T 3"]

    def mix(self, values: Float[np.ndarray, "V D"]) -> Float[np.ndarray, "P D"]:
        """Carry values over from the old mesh's vertices."""
        share = self.share[:, None]
        return (1 - share) * values[self.first] + share * values[self.second]


def cut(faces: Int[np.ndarray, "T 3"], field: Float[np.ndarray, " V"]) -> Mixture:
    """Keep the part of a mesh where `field` is positive; cut triangles where it passes zero."""
    inside = field > 0
    counts = inside[faces].sum(1)
    one = _lead_with(faces[counts == 1], inside, True)
    two = _lead_with(faces[counts == 2], inside, False)
    edges = np.concatenate([one[:, [0, 1]], one[:, [0, 2]], two[:, [1, 0]], two[:, [2, 0]]])
    edges = np.sort(edges, axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    index = index.reshape(-1) + len(field)
    near, far, left, right = np.split(index, np.cumsum([len(one), len(one), len(two)]))
    new_faces = np.concatenate(
        [
            faces[counts == 3],
            np.stack([one[:, 0], near, far], 1),
            np.stack([left, two[:, 1], two[:, 2]], 1),
            np.stack([left, two[:, 2], right], 1),
        ]
    )
    start, end = field[unique[:, 0]], field[unique[:, 1]]
    kept = np.arange(len(field))
    mixture = Mixture(
        first=np.concatenate([kept, unique[:, 0]]),
        second=np.concatenate([kept, unique[:, 1]]),
        share=np.concatenate([np.zeros(len(field)), start / (start - end)]),
        faces=new_faces,
    )
    return _without_unused(mixture)


def refine(faces: Int[np.ndarray, "T 3"], count: int) -> Mixture:
    """Halve every edge of a mesh with `count` vertices: each triangle becomes four."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    ab, bc, ca = (index.reshape(-1, 3) + count).T
    a, b, c = faces.T
    corners = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    kept = np.arange(count)
    return Mixture(
        first=np.concatenate([kept, unique[:, 0]]),
        second=np.concatenate([kept, unique[:, 1]]),
        share=np.concatenate([np.zeros(count), np.full(len(unique), 0.5)]),
        faces=np.concatenate([np.stack(corner, 1) for corner in corners]),
    )


def smooth(
    values: Float[np.ndarray, "P D"], faces: Int[np.ndarray, "T 3"], rounds: int
) -> Float[np.ndarray, "P D"]:
    """Move each vertex half way to the mean of its neighbours, `rounds` times; rims stay."""
    averaging, rim = neighbour_mean(faces, len(values))
    for _ in range(rounds):
        values = np.where(rim[:, None], values, 0.5 * values + 0.5 * (averaging @ values))
    return values


def neighbour_mean(
    faces: Int[np.ndarray, "T 3"], count: int
) -> tuple[csr_matrix, Bool[np.ndarray, " P"]]:
    """The matrix that averages each vertex's neighbours, and which vertices lie on a rim."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    both = np.concatenate([edges, edges[:, ::-1]])
    ones = np.ones(len(both))
    used = coo_matrix((ones, both.T), shape=(count, count)).tocsr()  # 2 an inner edge, 1 on a rim
    rim = np.zeros(count, bool)
    rim[used.tocoo().row[used.tocoo().data == 1]] = True
    used.data[:] = 1
    total = np.maximum(np.asarray(used.sum(1)).ravel(), 1)
    return diags(1 / total) @ used, rim


def vertex_normals(
    vertices: Float[np.ndarray, "P 3"], faces: Int[np.ndarray, "T 3"]
) -> Float[np.ndarray, "P 3"]:
    """Unit normals, the mean of those of the triangles around each vertex weighted by area."""
    total = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(total, faces[:, corner], face_normals(vertices, faces))
    return unit(total)


def _lead_with(
    faces: Int[np.ndarray, "T 3"], inside: Bool[np.ndarray, " V"], wanted: bool
) -> Int[np.ndarray, "T 3"]:
    """Turn triangles, keeping their sense, until the one vertex that is `wanted` comes first."""
    first = (inside[faces] == wanted).argmax(1)
    order = (first[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, order, axis=1)


def _without_unused(mixture: Mixture) -> Mixture:
    used, index = np.unique(mixture.faces, return_inverse=True)
    return Mixture(
        first=mixture.first[used],
        second=mixture.second[used],
        share=mixture.share[used],
        faces=index.reshape(mixture.faces.shape),
    )
