"""Ray casting of a textured triangle mesh: the ground truth that splatting is measured against.

Conventions. Cameras as in `geometry.cameras`. A pixel holds samples_per_axis^2 rays on a regular
grid. Colours are linear light, premultiplied by coverage, over nothing. A triangle's surface is cut
into R x R cells: the point (1 - u - v) a + u b + v c of triangle abc lies in cell (u R, v R),
rounded down, so that cells with i + j >= R are empty. Colours are kept per cell, which any mesh
has, unwrapped or not. T triangles, P vertices, Q rays, R cells along an edge.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Float, Float32, Int, Int32
from scipy.sparse import csr_matrix

from deblur_avatar.artifacts.cameras import Cameras

Cells = tuple[Int[np.ndarray, " Q"], Int[np.ndarray, " Q"]]


@dataclass(frozen=True)
class View:
    """One pinhole camera and the rays it casts."""

    K: Float[np.ndarray, "3 3"]  # pixels
    viewmat: Float[np.ndarray, "4 4"]  # world to camera
    width: int
    height: int
    samples_per_axis: int

    @classmethod
    def of(cls, cameras: Cameras, index: int, samples_per_axis: int) -> "View":
        """Take one of several cameras; its distortion is left out."""
        width, height = cameras.sizes[index].tolist()
        K, viewmat = cameras.Ks[index].double(), cameras.viewmats[index].double()
        return cls(K.numpy(), viewmat.numpy(), width, height, samples_per_axis)

    @cached_property
    def centre(self) -> Float32[np.ndarray, " 3"]:
        """Where the camera stands in the world, metres."""
        return (-self.viewmat[:3, :3].T @ self.viewmat[:3, 3]).astype(np.float32)

    @cached_property
    def directions(self) -> Float32[np.ndarray, "h w 3"]:
        """Unit vectors through every sample of the image, in the world."""
        count = self.samples_per_axis
        x, y = np.meshgrid(
            (np.arange(self.width * count) + 0.5) / count,
            (np.arange(self.height * count) + 0.5) / count,
        )
        pixels = np.stack([x, y, np.ones_like(x)], -1)
        rays = pixels @ np.linalg.inv(self.K).T @ self.viewmat[:3, :3]
        return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).astype(np.float32)

    def project(
        self, points: Float[np.ndarray, "*batch 3"]
    ) -> tuple[Float[np.ndarray, "*batch 2"], Float[np.ndarray, "*batch"]]:
        """Pixel positions, and depths in metres; positions mean nothing at depths <= 0."""
        seen = (points @ self.viewmat[:3, :3].T + self.viewmat[:3, 3]) @ self.K.T
        depth = seen[..., 2]
        return seen[..., :2] / np.maximum(depth, 1e-6)[..., None], depth


@dataclass(frozen=True)
class Hits:
    """Where rays first met a surface; `triangle` is -1 where they met none."""

    triangle: Int32[np.ndarray, " Q"]
    u: Float32[np.ndarray, " Q"]
    v: Float32[np.ndarray, " Q"]
    distance: Float32[np.ndarray, " Q"]  # metres along the ray, huge where nothing was met

    def cell(self, cells: int) -> Cells:
        """Which of its triangle's cells each ray met; for a missed ray, some cell."""
        i = np.clip((self.u * cells).astype(np.int32), 0, cells - 1)
        j = np.clip((self.v * cells).astype(np.int32), 0, cells - 1)
        return i, np.minimum(j, cells - 1 - i)


@dataclass(frozen=True)
class Lighting:
    """A soft sky, and lamps far away: what a white surface sends back of them. World +Y is up."""

    ambient: float  # from everywhere
    sky: float  # added on a surface that faces up, half of it on a wall
    lamps: tuple[tuple[tuple[float, float, float], float], ...]  # direction to it, strength

    def irradiance(self, normals: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, " P"]:
        """Light on surfaces with these unit normals, 1 where white paper is white."""
        light = self.ambient + self.sky * (0.5 + 0.5 * normals[:, 1])
        for direction, strength in self.lamps:
            aim = np.asarray(direction, normals.dtype)
            light = light + strength * np.maximum(normals @ (aim / np.linalg.norm(aim)), 0)
        return light


@dataclass(frozen=True)
class TexturedMesh:
    """What of a surface does not move with it."""

    faces: Int32[np.ndarray, "T 3"]
    albedo: Float32[np.ndarray, "T R R 3"]  # share of the light that is sent back

    @cached_property
    def vertex_from_face(self) -> csr_matrix:
        """Sums a value of each triangle into its vertices."""
        rows, columns = self.faces.ravel(), np.repeat(np.arange(len(self.faces)), 3)
        return csr_matrix((np.ones(len(rows), np.float32), (rows, columns)))


@dataclass(frozen=True)
class Picture:
    """Linear light premultiplied by coverage, and the share of each pixel that is covered."""

    light: Float32[np.ndarray, "H W 3"]
    coverage: Float32[np.ndarray, "H W"]


def cast_rays(
    vertices: Float[np.ndarray, "P 3"],
    faces: Int[np.ndarray, "T 3"],
    origins: Float[np.ndarray, "*origins 3"],
    directions: Float[np.ndarray, "Q 3"],
) -> Hits:
    """Find what each ray meets first, from one origin for all or one for each."""
    scene = EmbreeScene()
    TriangleMesh(scene, _packed(vertices), np.ascontiguousarray(faces, np.int32))
    starts = _packed(np.broadcast_to(origins, directions.shape))
    found = scene.run(starts, _packed(directions), output=True)
    return Hits(found["primID"], found["u"], found["v"], found["tfar"])


def face_normals(
    vertices: Float[np.ndarray, "P 3"], faces: Int[np.ndarray, "T 3"]
) -> Float[np.ndarray, "T 3"]:
    """Outward normals, twice as long as the triangles are large (square metres)."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return np.cross(b - a, c - a)


def unit(vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Scale vectors to length 1; those of no length stay 0."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-20)


def render(
    vertices: Float[np.ndarray, "P 3"], mesh: TexturedMesh, view: View, lighting: Lighting
) -> Picture:
    """Draw a diffuse surface without shadows, shaded at its vertices.

    Only the pixels of the mesh's box are visited. The mesh must lie in front of the camera.
    """
    samples = view.samples_per_axis
    light = np.zeros((view.height, view.width, 3), np.float32)
    coverage = np.zeros((view.height, view.width), np.float32)
    left, top, right, bottom = _box(vertices, view)
    if right <= left or bottom <= top:
        return Picture(light, coverage)
    rays = view.directions[top * samples : bottom * samples, left * samples : right * samples]
    hits = cast_rays(vertices, mesh.faces, view.centre, rays.reshape(-1, 3))
    met = np.flatnonzero(hits.triangle >= 0)
    triangle, u, v = hits.triangle[met], hits.u[met], hits.v[met]
    normals = unit(mesh.vertex_from_face @ face_normals(vertices, mesh.faces))
    corners = lighting.irradiance(normals)[mesh.faces[triangle]]
    shade = corners[:, 0] * (1 - u - v) + corners[:, 1] * u + corners[:, 2] * v
    i, j = hits.cell(mesh.albedo.shape[1])
    colour = np.zeros((len(hits.triangle), 4), np.float32)
    colour[met, :3] = mesh.albedo[triangle, i[met], j[met]] * shade[:, None]
    colour[met, 3] = 1
    grid = colour.reshape(bottom - top, samples, right - left, samples, 4)
    pixels = grid.mean((1, 3), dtype=np.float32)
    light[top:bottom, left:right] = pixels[..., :3]
    coverage[top:bottom, left:right] = pixels[..., 3]
    return Picture(light, coverage)


def used_cells(cells: int) -> Cells:
    """Indices of the cells that are not empty, row by row."""
    i, j = np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij")
    used = i + j < cells
    return i[used], j[used]


def cell_middles(
    cells: int,
) -> tuple[Float32[np.ndarray, " Q"], Float32[np.ndarray, " Q"]]:
    """Barycentric (u, v) in the middle of each used cell; those on the diagonal are triangles."""
    i, j = used_cells(cells)
    half = np.where(i + j == cells - 1, 1 / 3, 1 / 2)
    return ((i + half) / cells).astype(np.float32), ((j + half) / cells).astype(np.float32)


def _packed(array: Float[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    return np.ascontiguousarray(array, np.float32)


def _box(vertices: Float[np.ndarray, "P 3"], view: View) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of the pixels that hold the mesh, inside the image."""
    pixels, _ = view.project(vertices)
    size = (view.width, view.height)
    low = np.clip(np.floor(pixels.min(0)), 0, size).astype(int)
    high = np.clip(np.ceil(pixels.max(0)), 0, size).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])
