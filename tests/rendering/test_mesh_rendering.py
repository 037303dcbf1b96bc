import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.geometry.cameras import pixel_rays, project
from deblur_avatar.rendering.mesh_rendering import (
    Lighting,
    TexturedMesh,
    View,
    cast_rays,
    cell_middles,
    face_normals,
    render,
    used_cells,
)

pytestmark = pytest.mark.portable

EVEN = Lighting(ambient=1.0, sky=0.0, lamps=())
# A square of side 2 in the plane z = 0, facing +z, and a camera 4 m in front of it.
SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
FACING = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 4], [0, 0, 0, 1.0]])


def view(size: int = 12, samples: int = 2, focal: float = 12.0) -> View:
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    return View(K, FACING, size, size, samples)


def painted(colour: tuple[float, float, float], cells: int = 1) -> TexturedMesh:
    albedo = np.zeros((2, cells, cells, 3), np.float32) + np.float32(colour)
    return TexturedMesh(SQUARE_FACES, albedo)


def test_a_square_covers_the_pixels_it_projects_to():
    # Side 2 at depth 4 with focal length 12 is 6 pixels wide, from 3 to 9.
    picture = render(SQUARE, painted((0.5, 0.25, 1.0)), view(), EVEN)
    wanted = np.zeros((12, 12))
    wanted[3:9, 3:9] = 1
    np.testing.assert_array_equal(picture.coverage, wanted)
    np.testing.assert_allclose(picture.light[5, 5], (0.5, 0.25, 1.0))
    assert picture.light[0, 0].sum() == 0


def test_a_pixel_half_covered_is_half_covered_and_half_as_bright():
    shifted = SQUARE + np.float32([1 / 6, 0, 0])  # half a pixel to the right
    picture = render(shifted, painted((1, 1, 1)), view(samples=4), EVEN)
    np.testing.assert_allclose(picture.coverage[6, [2, 3, 8, 9]], [0, 0.5, 1, 0.5])
    np.testing.assert_allclose(picture.light[6, 3], 0.5)


def test_more_samples_change_nothing_where_nothing_varies():
    one = render(SQUARE, painted((0.2, 0.4, 0.6)), view(samples=1), EVEN)
    four = render(SQUARE, painted((0.2, 0.4, 0.6)), view(samples=4), EVEN)
    np.testing.assert_allclose(one.light, four.light, atol=1e-6)


def test_the_nearer_surface_hides_the_farther():
    vertices = np.concatenate([SQUARE, 0.5 * SQUARE + np.float32([0, 0, 1])])
    mesh = TexturedMesh(
        np.concatenate([SQUARE_FACES, SQUARE_FACES + 4]),
        np.float32([0.1, 0.1, 0.9, 0.9])[:, None, None, None] * np.ones((4, 1, 1, 3), np.float32),
    )
    picture = render(vertices, mesh, view(), EVEN)
    assert picture.light[6, 6, 0] == pytest.approx(0.9)
    assert picture.light[6, 3, 0] == pytest.approx(0.1)


def test_cells_colour_their_part_of_the_triangle():
    albedo = np.zeros((1, 2, 2, 3), np.float32)
    albedo[0, 0, 0, 0], albedo[0, 1, 0, 1], albedo[0, 0, 1, 2] = 1, 1, 1
    mesh = TexturedMesh(np.array([[0, 1, 3]], np.int32), albedo)
    picture = render(SQUARE, mesh, view(), EVEN)
    np.testing.assert_allclose(picture.light[7, 4], (1, 0, 0))  # near corner 0, bottom left
    np.testing.assert_allclose(picture.light[8, 7], (0, 1, 0))  # towards corner 1, bottom right
    np.testing.assert_allclose(picture.light[4, 3], (0, 0, 1))  # towards corner 3, top left


def test_light_falls_off_with_the_cosine():
    lamp = Lighting(ambient=0.1, sky=0.0, lamps=(((0.0, 3.0, 3.0), 0.5),))
    picture = render(SQUARE, painted((1, 1, 1)), view(), lamp)
    assert picture.light[6, 6, 0] == pytest.approx(0.1 + 0.5 * 2**-0.5, abs=1e-6)


def test_shade_runs_straight_from_vertex_to_vertex():
    # A roof whose ridge stands over x = 0; from there the light of a lamp on the right grows.
    roof = np.array([[x, y, 0.5 * (1 - abs(x))] for x in (-1, 0, 1) for y in (-1, 1)], np.float32)
    faces = np.array([[0, 2, 1], [1, 2, 3], [4, 5, 2], [5, 3, 2]], np.int32)
    mesh = TexturedMesh(faces, np.ones((4, 1, 1, 3), np.float32))
    lamp = Lighting(ambient=0.0, sky=0.0, lamps=(((1.0, 0.0, 0.0), 1.0),))
    shade = render(roof, mesh, view(48, 1, 48.0), lamp).light[14:34, :, 0]
    np.testing.assert_allclose(shade[:, 10:24], 0, atol=1e-6)  # the left slope
    right = shade[:, 25:35]
    assert np.ptp(right, axis=0).max() < 1e-5  # the same from top to bottom
    focal, ridge = 48.0, 0.5
    across = (np.arange(25, 35) + 0.5 - 24) / focal  # x of the roof: x / (4 - z) = across
    x = across * (4 - ridge) / (1 - ridge * across)
    np.testing.assert_allclose(right[0], x / 5**0.5, atol=1e-5)


def test_the_sky_lights_what_faces_up():
    sky = Lighting(ambient=0.0, sky=1.0, lamps=())
    up, wall, down = np.float32([[0, 1, 0], [1, 0, 0], [0, -1, 0]])
    np.testing.assert_allclose(sky.irradiance(np.stack([up, wall, down])), [1, 0.5, 0])


def test_a_mesh_outside_the_image_leaves_it_empty():
    picture = render(SQUARE + np.float32([50, 0, 0]), painted((1, 1, 1)), view(), EVEN)
    assert picture.coverage.max() == 0


def test_rays_and_projection_agree_with_the_camera_module():
    generator = torch.Generator().manual_seed(0)
    K = torch.tensor([[20.0, 0, 7], [0, 22, 4], [0, 0, 1]])
    cameras = Cameras(
        Ks=K[None],
        viewmats=torch.from_numpy(FACING).float()[None],
        distortion=torch.zeros(1, 5),
        sizes=torch.tensor([[10, 8]]),
        names=("only",),
    )
    ours = View.of(cameras, 0, 1)
    pixels = torch.tensor([[x + 0.5, y + 0.5] for y in range(8) for x in range(10)])
    origins, directions = pixel_rays(K, cameras.viewmats[0], pixels)
    np.testing.assert_allclose(ours.directions.reshape(-1, 3), directions.numpy(), atol=1e-6)
    np.testing.assert_allclose(ours.centre, origins[0].numpy(), atol=1e-6)
    points = torch.rand(5, 3, generator=generator)
    wanted, depth = project(points, K, cameras.viewmats[0])
    found, found_depth = ours.project(points.numpy())
    np.testing.assert_allclose(found, wanted.numpy(), rtol=1e-5)
    np.testing.assert_allclose(found_depth, depth.numpy(), rtol=1e-6)


def test_hits_are_where_the_ray_meets_the_triangle():
    generator = np.random.default_rng(0)
    origin = np.float32([0.3, -0.2, 5])
    targets = np.float32(generator.uniform(-0.9, 0.9, (20, 3)) * (1, 1, 0))
    aims = targets - origin
    lengths = np.linalg.norm(aims, axis=1)
    hits = cast_rays(SQUARE, SQUARE_FACES, origin, aims / lengths[:, None])
    corners = SQUARE[SQUARE_FACES[hits.triangle]]
    rest = 1 - hits.u - hits.v
    found = np.stack([rest, hits.u, hits.v], 1)[:, None] @ corners
    np.testing.assert_allclose(found[:, 0], targets, atol=1e-5)
    np.testing.assert_allclose(hits.distance, lengths, rtol=1e-5)


def test_a_ray_that_misses_says_so():
    hits = cast_rays(SQUARE, SQUARE_FACES, np.float32([0, 0, 5]), np.float32([[0, 0, 1]]))
    assert hits.triangle[0] == -1
    assert hits.distance[0] > 1e6


def test_cell_middles_lie_in_their_own_cells():
    from deblur_avatar.rendering.mesh_rendering import Hits

    u, v = cell_middles(5)
    zero = np.zeros(len(u), np.float32)
    i, j = Hits(zero.astype(np.int32), u, v, zero).cell(5)
    np.testing.assert_array_equal(np.stack([i, j]), np.stack(used_cells(5)))
    assert ((u + v) < 1).all()


def test_face_normals_point_out_of_counterclockwise_triangles():
    np.testing.assert_allclose(face_normals(SQUARE, SQUARE_FACES), [[0, 0, 4]] * 2)
