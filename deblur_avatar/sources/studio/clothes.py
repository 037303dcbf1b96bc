"""Dressing: from a resting body's surface to one mesh of skin, clothes, shoes and hair.

Conventions. Rest pose, metres. V vertices of the body; P vertices and T triangles of what is made.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, cKDTree

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.rendering.mesh_rendering import face_normals, unit
from deblur_avatar.sources.studio.garments import (
    GARMENTS,
    Garment,
    Landmarks,
    find_landmarks,
)
from deblur_avatar.sources.studio.shells import (
    Mixture,
    cut,
    refine,
    smooth,
    vertex_normals,
)

PIECES = ("skin", *(garment.piece for garment in GARMENTS), "shoes")
HIDDEN_DEPTH = 0.03  # metres inside a hem from where on the skin below is left out
SHOE_THICKNESS = 0.007  # metres
SHOE_TOP = 0.012  # metres below the ankle's joint


@dataclass(frozen=True)
class Surface:
    """A mesh that is skinned with the body."""

    vertices: Float[np.ndarray, "P 3"]
    normals: Float[np.ndarray, "P 3"]
    lbs_weights: Float[np.ndarray, "P J"]
    looseness: Float[np.ndarray, " P"]
    slack: Float[np.ndarray, " P"]  # metres a vertex may move inwards
    faces: Int[np.ndarray, "T 3"]


@dataclass(frozen=True)
class Clothed:
    """A clothed person at rest."""

    surface: Surface
    pieces: Int[np.ndarray, " T"]  # index into PIECES
    landmarks: Landmarks


def clothe(
    vertices: Float[np.ndarray, "V 3"],
    joints: Float[np.ndarray, "J 3"],
    lbs_weights: Float[np.ndarray, "V J"],
    faces: Int[np.ndarray, "F 3"],
) -> Clothed:
    """Put clothes, shoes and hair on a resting body, which must have SMPL's joints."""
    marks = find_landmarks(vertices, joints, lbs_weights)
    body = _tight_surface(vertices, lbs_weights, faces)
    parts = [("skin", _bare_skin(body, marks))]
    parts += [(garment.piece, _shell(garment, body, marks)) for garment in GARMENTS]
    parts += [("shoes", _shoe(side, body, marks)) for side in ("left", "right")]
    pieces = [np.full(len(part.faces), PIECES.index(name)) for name, part in parts]
    return Clothed(_joined([part for _, part in parts]), np.concatenate(pieces), marks)


def _bare_skin(body: Surface, marks: Landmarks) -> Surface:
    """What can be seen of the body: all but what lies deep under a garment, hair excepted."""
    covers = [g.covers(body.vertices, body.lbs_weights, marks) for g in GARMENTS if not g.on_head]
    covers.append(marks.of("left_ankle")[1] - 0.02 - body.vertices[:, 1])  # in the shoes
    bare = cut(body.faces, HIDDEN_DEPTH - np.max(covers, axis=0))
    return _carried(body, bare)


def _shell(garment: Garment, body: Surface, marks: Landmarks) -> Surface:
    """Lift the covered part off the body and smooth it, nowhere nearer than its distance."""
    below = _carried(body, cut(body.faces, garment.covers(body.vertices, body.lbs_weights, marks)))
    if garment.refined:
        below = _carried(below, refine(below.faces, len(below.vertices)))
    outward, faces = unit(below.normals), below.faces
    looseness = garment.looseness(below.vertices, marks)
    distance = garment.tight + (garment.loose - garment.tight) * looseness
    shell = smooth(below.vertices + distance[:, None] * outward, faces, garment.smoothing)
    short = distance - ((shell - below.vertices) * outward).sum(1)
    shell += np.maximum(short, 0)[:, None] * outward
    weights = smooth(below.lbs_weights, faces, garment.smoothing // 4)
    return Surface(
        vertices=shell,
        normals=vertex_normals(shell, faces),
        lbs_weights=weights / weights.sum(1, keepdims=True),
        looseness=looseness,
        slack=distance - garment.least,
        faces=faces,
    )


def _shoe(side: str, body: Surface, marks: Landmarks) -> Surface:
    """A rounded hull around the foot, which hides the toes."""
    bones = [SMPL_JOINT_NAMES.index(f"{side}_{name}") for name in ("ankle", "foot")]
    low = body.vertices[:, 1] < marks.of(f"{side}_ankle")[1] - SHOE_TOP
    foot = (body.lbs_weights[:, bones].sum(1) > 0.5) & low
    points = body.vertices[foot]
    hull = ConvexHull(points)
    used, index = np.unique(hull.simplices, return_inverse=True)
    corners, faces = points[used], index.reshape(-1, 3)
    inwards = (face_normals(corners, faces) * hull.equations[:, :3]).sum(1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    for _ in range(2):
        finer = refine(faces, len(corners))
        corners, faces = finer.mix(corners), finer.faces
    rounded = smooth(corners, faces, 4)
    normals = vertex_normals(rounded, faces)
    lost = np.maximum(((corners - rounded) * normals).sum(1), 0)
    shell = rounded + (SHOE_THICKNESS + lost)[:, None] * normals
    _, nearest = cKDTree(points).query(shell, k=min(8, len(points)))
    return _tight_surface(shell, body.lbs_weights[foot][nearest].mean(1), faces)


def _tight_surface(
    vertices: Float[np.ndarray, "P 3"],
    lbs_weights: Float[np.ndarray, "P J"],
    faces: Int[np.ndarray, "T 3"],
) -> Surface:
    none = np.zeros(len(vertices))
    return Surface(vertices, vertex_normals(vertices, faces), lbs_weights, none, none, faces)


def _carried(surface: Surface, mixture: Mixture) -> Surface:
    """The part of a surface that a mixture keeps; its normals are no longer quite unit."""
    return Surface(
        vertices=mixture.mix(surface.vertices),
        normals=mixture.mix(surface.normals),
        lbs_weights=mixture.mix(surface.lbs_weights),
        looseness=mixture.mix(surface.looseness[:, None])[:, 0],
        slack=mixture.mix(surface.slack[:, None])[:, 0],
        faces=mixture.faces,
    )


def _joined(parts: Sequence[Surface]) -> Surface:
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Surface(
        vertices=np.concatenate([part.vertices for part in parts]),
        normals=np.concatenate([part.normals for part in parts]),
        lbs_weights=np.concatenate([part.lbs_weights for part in parts]),
        looseness=np.concatenate([part.looseness for part in parts]),
        slack=np.concatenate([part.slack for part in parts]),
        faces=np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=True)]),
    )
