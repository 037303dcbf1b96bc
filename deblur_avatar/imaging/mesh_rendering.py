"""Pictures of a textured triangle mesh by casting rays: what splatting is measured against.

Conventions. Cameras as in `geometry.cameras`. A pixel holds samples_per_axis^2 rays on a regular
grid. Colours are linear light, premultiplied by coverage, over nothing. A triangle's surface is cut
into R x R cells: the point (1 - u - v) a + u b + v c of triangle abc lies in cell (u R, v R) rounded
down, so cells with i + j >= R are empty. Albedos, and what a camera has seen, are kept per cell, which
any mesh has, unwrapped or not. T triangles, P vertices, Q rays, R cells along an edge.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Float32, Int, Int32
from scipy.sparse import csr_matrix

MISSED = -1  # the triangle of a ray that hits nothing
SAME_SURFACE = 1e-3  # metres; a point this far behind the first hit still counts as that surface
GRAZING = 0.1  # cosine; a surface seen flatter than 84 degrees shows nothing of itself


@dataclass(frozen=True)
class View:
    """One pinhole camera and the rays it casts."""

    K: Float[np.ndarray, "3 3"]  # pixels
    viewmat: Float[np.ndarray, "4 4"]  # world to camera
    width: int
    height: int
    samples_per_axis: int

    @cached_property
    def centre(self) -> Float32[np.ndarray, " 3"]:
        """Where the camera stands in the world, metres."""
        return (-self.viewmat[:3, :3].T @ self.viewmat[:3, 3]).astype(np.float32)

    @cached_property
    def directions(self) -> Float32[np.ndarray, "h w 3"]:
        """Unit vectors through every sample of the image, in the world."""
        count = self.samples_per_axis
        x, y = ((np.arange(size * count) + 0.5) / count for size in (self.width, self.height))
        x, y = np.meshgrid(x, y)
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
    """Where rays first met a surface; `triangle` is `MISSED` where they met none."""

    triangle: Int32[np.ndarray, " Q"]
    u: Float32[np.ndarray, " Q"]
    v: Float32[np.ndarray, " Q"]
    distance: Float32[np.ndarray, " Q"]  # metres along the ray

    def cell(self, cells: int) -> tuple[Int[np.ndarray, " Q"], Int[np.ndarray, " Q"]]:
        """Which of a triangle's cells was met; for a missed ray, some cell."""
        i = np.clip((self.u * cells).astype(np.int32), 0, cells - 1)
        j = np.clip((self.v * cells).astype(np.int32), 0, cells - 1)
        return i, np.minimum(j, cells - 1 - i)


@dataclass(frozen=True)
class Lighting:
    """A soft sky and lamps far away; what a white surface facing each of them sends back."""

    ambient: float
    sky: float  # added from straight above, fading to nothing from below
    lamps: tuple[tuple[tuple[float, float, float], float], ...]  # direction to it, strength

    def irradiance(self, normals: Float[np.ndarray, "P 3"]) -> Float[np.ndarray, " P"]:
        """Light on surfaces with these unit normals; world +Y is up."""
        light = self.ambient + self.sky * (0.5 + 0.5 * normals[:, 1])
        for direction, strength in self.lamps:
            aim = np.asarray(direction, normals.dtype)
            light = light + strength * np.maximum(normals @ (aim / np.linalg.norm(aim)), 0)
        return light


@dataclass(frozen=True)
class TexturedMesh:
    """What of a surface does not move with it."""

    faces: Int[np.ndarray, "T 3"]
    albedo: Float32[np.ndarray, "T R R 3"]  # linear light, share that is sent back

    @cached_property
    def vertex_from_face(self) -> csr_matrix:
        """Sums a value of each triangle into its vertices."""
        rows = self.faces.ravel()
        columns = np.repeat(np.arange(len(self.faces)), 3)
        return csr_matrix((np.ones(len(rows), np.float32), (rows, columns)))


@dataclass(frozen=True)
class Picture:
    """Linear light premultiplied by coverage, and the share of each pixel that is covered."""

    light: Float32[np.ndarray, "H W 3"]
    coverage: Float32[np.ndarray, "H W"]


def cast_rays(
    vertices: Float[np.ndarray, "P 3"],
    faces: Int[np.ndarray, "T 3"],
    origin: Float[np.ndarray, " 3"],
    directions: Float[np.ndarray, "Q 3"],
) -> Hits:
    """Find what rays from one point meet first."""
    scene = EmbreeScene()
    TriangleMesh(
        scene,
        np.ascontiguousarray(vertices, np.float32),
        np.ascontiguousarray(faces, np.int32),
    )
    origins = np.ascontiguousarray(np.broadcast_to(origin, directions.shape), np.float32)
    found = scene.run(origins, np.ascontiguousarray(directions, np.float32), output=True)
    return Hits(found["primID"], found["u"], found["v"], found["tfar"])


def vertex_normals(
    vertices: Float[np.ndarray, "P 3"], mesh: TexturedMesh
) -> Float[np.ndarray, "P 3"]:
    """Unit normals, the mean of the triangles' around each vertex weighted by area."""
    a, b, c = (vertices[mesh.faces[:, corner]] for corner in range(3))
    normals = mesh.vertex_from_face @ np.cross(b - a, c - a)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)


def render(
    vertices: Float[np.ndarray, "P 3"], mesh: TexturedMesh, view: View, lighting: Lighting
) -> Picture:
    """Draw one picture: diffuse surfaces, both sides alike, without shadows.

    Vertices behind the camera are not supported.
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
    irradiance = lighting.irradiance(vertex_normals(vertices, mesh)).astype(np.float32)
    corners = irradiance[mesh.faces[triangle]]
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


def render_sequence(
    frames: Iterable[Float[np.ndarray, "P 3"]],
    mesh: TexturedMesh,
    view: View,
    lighting: Lighting,
    workers: int,
) -> Iterator[Picture]:
    """Draw a moving mesh, in order, on `workers` threads; the pictures do not depend on how many."""
    draw = partial(render, mesh=mesh, view=view, lighting=lighting)
    _ = view.directions, view.centre, mesh.vertex_from_face  # once, before threads ask for them
    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[Future[Picture]] = deque()
        for vertices in frames:
            waiting.append(pool.submit(draw, vertices))
            if len(waiting) > 2 * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def seen_cells(
    frames: Iterable[Float[np.ndarray, "P 3"]],
    faces: Int[np.ndarray, "T 3"],
    view: View,
    cells: int,
) -> Bool[np.ndarray, "T R R"]:
    """Which parts of a moving surface a camera saw in some frame.

    A cell is seen if its middle lies inside the image, is the first thing on its ray, and does not
    turn away from the camera by more than `GRAZING` allows.
    """
    u, v = cell_middles(cells)
    seen = np.zeros((len(faces), len(u)), bool)
    for vertices in frames:
        a, b, c = (vertices[faces[:, corner]] for corner in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
        points = a[:, None] + u[:, None] * (b - a)[:, None] + v[:, None] * (c - a)[:, None]
        towards = points - view.centre
        distance = np.linalg.norm(towards, axis=-1)
        cosine = -(towards * normals[:, None]).sum(-1) / distance
        pixels, depth = view.project(points)
        inside = (pixels >= 0) & (pixels < (view.width, view.height))
        asked = (cosine > GRAZING) & inside.all(-1) & (depth > 0) & ~seen
        hits = cast_rays(vertices, faces, view.centre, (towards / distance[..., None])[asked])
        seen[asked] = hits.distance >= distance[asked] - SAME_SURFACE
    grid = np.zeros((len(faces), cells, cells), bool)
    i, j = _used_cells(cells)
    grid[:, i, j] = seen
    return grid


def seen_pixels(
    vertices: Float[np.ndarray, "P 3"],
    faces: Int[np.ndarray, "T 3"],
    view: View,
    seen: Bool[np.ndarray, "T R R"],
) -> Bool[np.ndarray, "H W"]:
    """Pixels of a view whose surface was seen, by the majority of the rays that meet a surface."""
    hits = cast_rays(vertices, faces, view.centre, view.directions.reshape(-1, 3))
    i, j = hits.cell(seen.shape[1])
    met = hits.triangle >= 0
    known = met & seen[np.maximum(hits.triangle, 0), i, j]
    samples = view.samples_per_axis
    votes = np.stack([met, known], -1).reshape(view.height, samples, view.width, samples, 2)
    counts = votes.sum((1, 3))
    return (counts[..., 0] > 0) & (2 * counts[..., 1] >= counts[..., 0])


def cell_middles(
    cells: int,
) -> tuple[Float32[np.ndarray, " D"], Float32[np.ndarray, " D"]]:
    """Barycentric (u, v) in the middle of each cell that is not empty, row by row.

    Cells on the diagonal are triangles, the others squares.
    """
    i, j = _used_cells(cells)
    half = np.where(i + j == cells - 1, 1 / 3, 0.5)
    return ((i + half) / cells).astype(np.float32), ((j + half) / cells).astype(np.float32)


def _used_cells(cells: int) -> tuple[Int[np.ndarray, " D"], Int[np.ndarray, " D"]]:
    i, j = np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij")
    used = i + j < cells
    return i[used], j[used]


def _box(vertices: Float[np.ndarray, "P 3"], view: View) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of the pixels that hold the mesh, inside the image."""
    pixels, _ = view.project(vertices)
    low = np.clip(np.floor(pixels.min(0)), 0, (view.width, view.height)).astype(int)
    high = np.clip(np.ceil(pixels.max(0)), 0, (view.width, view.height)).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])
