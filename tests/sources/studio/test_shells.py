import numpy as np
import trimesh

from deblur_avatar.sources.studio.shells import (
    cut,
    neighbour_mean,
    refine,
    smooth,
    vertex_normals,
)

BALL = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
VERTICES, FACES = np.asarray(BALL.vertices), np.asarray(BALL.faces)


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    return float(trimesh.Trimesh(vertices, faces, process=False).area)


def test_a_cut_ends_exactly_where_the_field_is_zero():
    half = cut(FACES, VERTICES[:, 1] - 0.3)
    points = half.mix(VERTICES)
    assert points[:, 1].min() > 0.3 - 1e-12
    _, rim = neighbour_mean(half.faces, len(points))
    np.testing.assert_allclose(points[rim, 1], 0.3)
    # A cap of height h of the unit sphere has area 2 pi h.
    assert abs(area(points, half.faces) / (2 * np.pi * 0.7) - 1) < 0.02


def test_both_sides_of_a_cut_make_up_the_whole():
    field = VERTICES @ (0.3, 0.8, -0.2) - 0.15
    parts = [cut(FACES, field), cut(FACES, -field)]
    total = sum(area(part.mix(VERTICES), part.faces) for part in parts)
    assert abs(total - BALL.area) < 1e-9


def test_a_cut_keeps_the_outside_outside():
    part = cut(FACES, VERTICES @ (0.3, 0.8, -0.2) - 0.13)
    points = part.mix(VERTICES)
    centres = points[part.faces].mean(1)
    a, b, c = (points[part.faces[:, k]] for k in range(3))
    assert ((np.cross(b - a, c - a) * centres).sum(1) >= -1e-12).all()


def test_cutting_where_all_is_inside_changes_nothing():
    whole = cut(FACES, np.ones(len(VERTICES)))
    np.testing.assert_array_equal(whole.mix(VERTICES), VERTICES)
    np.testing.assert_array_equal(whole.faces, FACES)


def test_cutting_where_nothing_is_inside_leaves_nothing():
    nothing = cut(FACES, -np.ones(len(VERTICES)))
    assert len(nothing.faces) == 0
    assert len(nothing.mix(VERTICES)) == 0


def test_values_mix_linearly_along_cut_edges():
    faces = np.array([[0, 1, 2]])
    part = cut(faces, np.array([1.0, -3.0, -1.0]))
    values = np.array([[0.0], [8.0], [4.0]])
    np.testing.assert_allclose(np.sort(part.mix(values)[:, 0]), [0, 2, 2])


def test_refining_makes_four_of_each_triangle_on_the_same_surface():
    fine = refine(FACES, len(VERTICES))
    points = fine.mix(VERTICES)
    assert len(fine.faces) == 4 * len(FACES)
    assert abs(area(points, fine.faces) - BALL.area) < 1e-9
    mesh = trimesh.Trimesh(points, fine.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent


def test_smoothing_shrinks_bumps_and_leaves_rims():
    part = cut(FACES, VERTICES[:, 1])
    points = part.mix(VERTICES)
    _, rim = neighbour_mean(part.faces, len(points))
    bumpy = points + 0.05 * np.random.default_rng(0).standard_normal(points.shape)
    calm = smooth(bumpy, part.faces, 5)
    np.testing.assert_array_equal(calm[rim], bumpy[rim])
    rough = np.linalg.norm(bumpy[~rim], axis=1).std()
    assert np.linalg.norm(calm[~rim], axis=1).std() < 0.6 * rough


def test_a_constant_survives_smoothing():
    constant = np.full((len(VERTICES), 2), 3.5)
    np.testing.assert_allclose(smooth(constant, FACES, 10), constant)


def test_vertex_normals_of_a_ball_point_outwards():
    np.testing.assert_allclose(vertex_normals(VERTICES, FACES), VERTICES, atol=0.02)
