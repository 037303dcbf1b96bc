import numpy as np
import trimesh

from deblur_avatar.rendering.mesh_rendering import View
from deblur_avatar.rendering.visibility import (
    openness,
    seen_cells,
    seen_pixels,
)

BALL = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
VERTICES, FACES = BALL.vertices.astype(np.float32), BALL.faces.astype(np.int32)


def view(sign: float = 1.0, size: int = 40, focal: float = 40.0) -> View:
    """A camera 4 m from the ball on +Z, or on -Z."""
    viewmat = np.diag([sign, -1.0, -sign, 1.0])
    viewmat[2, 3] = 4
    K = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    return View(K, viewmat, size, size, 2)


def test_a_camera_sees_the_near_half_of_a_ball():
    seen = seen_cells([VERTICES], FACES, view(), 2)
    used = np.array([[1, 1], [1, 0]], bool)
    whole, part = seen[:, used].all(1), seen[:, used].any(1)
    height = BALL.triangles_center[:, 2]
    # From 4 m the horizon of a ball of radius 1 lies at z = 1 / 4; grazing views end before it.
    assert whole[height > 0.45].all()
    assert not part[height < 0.2].any()
    assert not seen[:, 1, 1].any()  # beyond the diagonal there is no surface


def test_what_any_frame_shows_is_seen():
    turned = VERTICES * np.float32([-1, 1, -1])  # half a turn about Y
    front = seen_cells([VERTICES], FACES, view(), 1)
    back = seen_cells([turned], FACES, view(), 1)
    both = seen_cells([VERTICES, turned], FACES, view(), 1)
    np.testing.assert_array_equal(both, front | back)
    assert both.sum() > 1.8 * front.sum()


def test_what_hides_behind_something_is_not_seen():
    screen = np.float32([[-3, -3, 2], [3, -3, 2], [0, 4, 2]])
    vertices = np.concatenate([VERTICES, screen])
    faces = np.concatenate([FACES, np.int32([[0, 1, 2]]) + len(VERTICES)])
    seen = seen_cells([vertices], faces, view(), 1)
    assert seen[-1].all()
    assert not seen[:-1].any()


def test_what_is_seen_edge_on_or_from_behind_is_not_seen():
    sheet = np.float32([[-1, -1, 0], [1, -1, 0], [0, 1, 0]])
    faces = np.int32([[0, 1, 2]])

    def seen_at(degrees: float) -> bool:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turned = 0.01 * sheet @ np.float32([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        return bool(seen_cells([turned], faces, view(), 1).any())

    assert [seen_at(angle) for angle in (0, 82, 87, 180)] == [True, True, False, False]


def test_what_lies_outside_the_image_is_not_seen():
    seen = seen_cells([VERTICES + np.float32([0, 2, 0])], FACES, view(focal=80.0), 1)[:, 0, 0]
    assert 0 < seen.sum() < seen_cells([VERTICES], FACES, view(), 1).sum()
    assert not seen[BALL.triangles_center[:, 1] > 0.2].any()


def test_the_training_view_itself_shows_only_seen_pixels():
    seen = seen_cells([VERTICES], FACES, view(), 3)
    known = seen_pixels(VERTICES, FACES, view(), seen)
    disc = np.hypot(*(np.mgrid[:40, :40] + 0.5 - 20))
    assert known[disc < 9].all()
    assert not known[disc > 11.5].any()  # no surface there


def test_the_far_side_shows_no_seen_pixels():
    seen = seen_cells([VERTICES], FACES, view(), 3)
    assert not seen_pixels(VERTICES, FACES, view(-1.0), seen)[10:30, 10:30].any()


def test_a_ball_in_the_open_sees_all_of_the_sky():
    light = openness(VERTICES, VERTICES, FACES, 32)
    np.testing.assert_allclose(light, 1, atol=1e-6)


def test_a_corner_sees_half_the_sky():
    # A floor and a long wall that meet at x = 0; a point just beside the wall.
    floor = np.float32([[0, 0, -90], [0, 0, 90], [90, 0, 0]])
    wall = np.float32([[0, 0, -90], [0, 90, 0], [0, 0, 90]])
    vertices = np.concatenate([floor, wall, np.float32([[0.001, 0, 0]])])
    normals = np.float32([[0, 1, 0]] * 7)
    light = openness(vertices, normals, np.int32([[0, 1, 2], [3, 4, 5]]), 400)
    assert abs(light[6] - 0.5) < 0.03
