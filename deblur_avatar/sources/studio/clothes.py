"""What the person wears, as shells over the body's surface.

Conventions. Rest pose, metres. A garment covers the part of the body where its field is positive;
fields are distances from its hems, roughly in metres. P vertices and T triangles of the dressed
person: what the clothes leave of the skin, and the clothes.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, cKDTree

from deblur_avatar.artifacts import SMPL_JOINT_NAMES
from deblur_avatar.sources.studio.landmarks import HEAD, Landmarks, find_landmarks, rise
from deblur_avatar.sources.studio.shells import Mixture, cut, normals_of, refine, smooth

PIECES = ("skin", "shirt", "shorts", "socks", "shoes", "hair")
HIDDEN_DEPTH = 0.03  # metres inside a hem from where on the skin below is left out
SHOE_THICKNESS = 0.007  # metres
Field = Callable[[Float[np.ndarray, "N 3"], Landmarks], Float[np.ndarray, " N"]]


@dataclass(frozen=True)
class Dressed:
    """A clothed person at rest."""

    vertices: Float[np.ndarray, "P 3"]
    normals: Float[np.ndarray, "P 3"]
    lbs_weights: Float[np.ndarray, "P J"]
    looseness: Float[np.ndarray, " P"]  # 0 skin or tight, 1 the loosest hem
    slack: Float[np.ndarray, " P"]  # metres that a vertex may move inwards
    faces: Int[np.ndarray, "T 3"]
    pieces: Int[np.ndarray, " T"]  # index into PIECES
    landmarks: Landmarks


@dataclass(frozen=True)
class Garment:
    """A shell; its distance from the body goes from `tight` to `loose` with its looseness."""

    piece: str
    field: Field
    looseness: Field
    tight: float
    loose: float
    least: float  # distance below which the cloth never sinks
    smoothing: int


def dress(
    vertices: Float[np.ndarray, "V 3"],
    joints: Float[np.ndarray, "J 3"],
    lbs_weights: Float[np.ndarray, "V J"],
    faces: Int[np.ndarray, "F 3"],
) -> Dressed:
    """Put clothes, shoes and hair on a resting body."""
    marks = find_landmarks(vertices, joints, lbs_weights)
    normals = normals_of(vertices, faces)
    parts = [_skin(vertices, normals, lbs_weights, faces, marks)]
    parts += [_shell(g, vertices, normals, lbs_weights, faces, marks) for g in GARMENTS]
    parts += [_shoe(side, vertices, lbs_weights, marks) for side in ("left", "right")]
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts])
    return Dressed(
        vertices=np.concatenate([part.vertices for part in parts]),
        normals=np.concatenate([part.normals for part in parts]),
        lbs_weights=np.concatenate([part.lbs_weights for part in parts]),
        looseness=np.concatenate([part.looseness for part in parts]),
        slack=np.concatenate([part.slack for part in parts]),
        faces=np.concatenate([p.faces + o for p, o in zip(parts, offsets, strict=False)]),
        pieces=np.concatenate([part.pieces for part in parts]),
        landmarks=marks,
    )


def _shirt(points: Float[np.ndarray, "N 3"], marks: Landmarks) -> Float[np.ndarray, " N"]:
    neck = marks.of("neck") + (0, 0.035, 0)
    sleeve = 0.35 * marks.of("left_shoulder")[0] + 0.65 * marks.of("left_elbow")[0]
    collar = np.linalg.norm((points - neck) * (1, 0.9, 1), axis=1) - 0.1
    hem = points[:, 1] - (marks.of("pelvis")[1] - 0.045)
    ends = np.minimum(sleeve - np.abs(points[:, 0]), neck[1] + 0.02 - points[:, 1])
    return np.minimum(np.minimum(collar, hem), ends)


def _shirt_looseness(points: Float[np.ndarray, "N 3"], marks: Landmarks) -> Float[np.ndarray, " N"]:
    hem = rise(points[:, 1], marks.of("spine2")[1], marks.of("pelvis")[1] - 0.05)
    sleeve = rise(
        np.abs(points[:, 0]), marks.of("left_shoulder")[0], marks.of("left_elbow")[0] - 0.06
    )
    return np.maximum(hem, sleeve)


def _shorts(points: Float[np.ndarray, "N 3"], marks: Landmarks) -> Float[np.ndarray, " N"]:
    waist = marks.of("pelvis")[1] + 0.05 - points[:, 1]
    return np.minimum(waist, points[:, 1] - (marks.of("left_knee")[1] + 0.05))


def _shorts_looseness(
    points: Float[np.ndarray, "N 3"], marks: Landmarks
) -> Float[np.ndarray, " N"]:
    return rise(points[:, 1], marks.of("left_hip")[1], marks.of("left_knee")[1] + 0.05)


def _socks(points: Float[np.ndarray, "N 3"], marks: Landmarks) -> Float[np.ndarray, " N"]:
    ankle = marks.of("left_ankle")[1]
    return np.minimum(ankle + 0.16 - points[:, 1], points[:, 1] - (ankle - 0.05))


def _hair(points: Float[np.ndarray, "N 3"], marks: Landmarks) -> Float[np.ndarray, " N"]:
    x, y, z = marks.in_head(points).T
    line = 0.02 + 0.38 * rise(z, -0.25, 0.12) + 0.32 * rise(z, 0.1, 0.48)
    return np.minimum(y - line - 0.02 * np.cos(9 * x), 0.485 - np.abs(x)) * marks.head_size


def _hair_looseness(points: Float[np.ndarray, "N 3"], marks: Landmarks) -> Float[np.ndarray, " N"]:
    return rise(_hair(points, marks), 0.0, 0.05)


def _none(points: Float[np.ndarray, "N 3"], marks: Landmarks) -> Float[np.ndarray, " N"]:
    return np.zeros(len(points))


GARMENTS = (
    Garment("shirt", _shirt, _shirt_looseness, 0.015, 0.028, 0.012, 40),
    Garment("shorts", _shorts, _shorts_looseness, 0.007, 0.024, 0.006, 30),
    Garment("socks", _socks, _none, 0.004, 0.004, 0.003, 2),
    Garment("hair", _hair, _hair_looseness, 0.006, 0.026, 0.005, 6),
)


def _skin(
    vertices: Float[np.ndarray, "V 3"],
    normals: Float[np.ndarray, "V 3"],
    lbs_weights: Float[np.ndarray, "V J"],
    faces: Int[np.ndarray, "F 3"],
    marks: Landmarks,
) -> Dressed:
    """What can be seen of the body: all but what lies deep under a garment."""
    covers = [_cover(g, vertices, lbs_weights, marks) for g in GARMENTS if g.piece != "hair"]
    covers.append(marks.of("left_ankle")[1] - 0.02 - vertices[:, 1])  # in the shoes
    bare = cut(faces, HIDDEN_DEPTH - np.max(covers, axis=0))
    at = bare.mix(vertices)
    none = np.zeros(len(at))
    return _part(
        "skin", at, bare.mix(normals), bare.mix(lbs_weights), none, none, bare.faces, marks
    )


def _shell(
    garment: Garment,
    vertices: Float[np.ndarray, "V 3"],
    normals: Float[np.ndarray, "V 3"],
    lbs_weights: Float[np.ndarray, "V J"],
    faces: Int[np.ndarray, "F 3"],
    marks: Landmarks,
) -> Dressed:
    """Lift the covered part off the body and smooth it, nowhere nearer than the cloth's distance."""
    coarse = cut(faces, _cover(garment, vertices, lbs_weights, marks))
    fine = refine(coarse.faces, len(coarse.first))

    def carry(values: Float[np.ndarray, "V D"]) -> Float[np.ndarray, "P D"]:
        return fine.mix(coarse.mix(values))

    at, outward = carry(vertices), carry(normals)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    looseness = garment.looseness(at, marks)
    distance = garment.tight + (garment.loose - garment.tight) * looseness
    shell = smooth(at + distance[:, None] * outward, fine.faces, garment.smoothing)
    short = distance - ((shell - at) * outward).sum(1)
    shell += np.maximum(short, 0)[:, None] * outward
    weights = smooth(carry(lbs_weights), fine.faces, garment.smoothing // 4)
    slack = distance - garment.least
    return _part(
        garment.piece, shell, normals_of(shell, fine.faces), weights, looseness, slack,
        fine.faces, marks,
    )  # fmt: skip


def _cover(
    garment: Garment,
    vertices: Float[np.ndarray, "V 3"],
    lbs_weights: Float[np.ndarray, "V J"],
    marks: Landmarks,
) -> Float[np.ndarray, " V"]:
    on_head = lbs_weights[:, HEAD] > 0.5  # else chins wear shirts, and hands held high grow hair
    allowed = on_head if garment.piece == "hair" else ~on_head
    return np.where(allowed, garment.field(vertices, marks), -1.0)


def _shoe(
    side: str,
    vertices: Float[np.ndarray, "V 3"],
    lbs_weights: Float[np.ndarray, "V J"],
    marks: Landmarks,
) -> Dressed:
    """A rounded hull around the foot, which hides the toes."""
    bones = [SMPL_JOINT_NAMES.index(f"{side}_{name}") for name in ("ankle", "foot")]
    ankle = marks.of(f"{side}_ankle")[1]
    foot = (lbs_weights[:, bones].sum(1) > 0.5) & (vertices[:, 1] < ankle - 0.012)
    points = vertices[foot]
    hull = ConvexHull(points)
    used, faces = np.unique(hull.simplices, return_inverse=True)
    corners, faces = points[used], faces.reshape(-1, 3)
    a, b, c = (corners[faces[:, k]] for k in range(3))
    inwards = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(1) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    for _ in range(2):
        finer = refine(faces, len(corners))
        corners, faces = finer.mix(corners), finer.faces
    shell = smooth(corners, faces, 4)
    normals = normals_of(shell, faces)
    shell = (
        shell
        + normals * (SHOE_THICKNESS + np.maximum(0, ((corners - shell) * normals).sum(1)))[:, None]
    )
    _, nearest = cKDTree(points).query(shell, k=min(8, len(points)))
    weights = lbs_weights[foot][nearest].mean(1)
    none = np.zeros(len(shell))
    return _part("shoes", shell, normals, weights, none, none, faces, marks)


def _part(
    piece: str,
    vertices: Float[np.ndarray, "P 3"],
    normals: Float[np.ndarray, "P 3"],
    lbs_weights: Float[np.ndarray, "P J"],
    looseness: Float[np.ndarray, " P"],
    slack: Float[np.ndarray, " P"],
    faces: Int[np.ndarray, "T 3"],
    marks: Landmarks,
) -> Dressed:
    return Dressed(
        vertices=vertices,
        normals=normals,
        lbs_weights=lbs_weights / lbs_weights.sum(1, keepdims=True),
        looseness=looseness,
        slack=slack,
        faces=faces,
        pieces=np.full(len(faces), PIECES.index(piece)),
        landmarks=marks,
    )
