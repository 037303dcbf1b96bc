import torch

from deblur_avatar.avatars.surface_projection import closest_points, vertex_normals

CUBE = torch.tensor([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
SQUARES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
FACES = torch.tensor([t for a, b, c, d in SQUARES for t in ((a, b, c), (a, c, d))])


def test_normals_point_out_and_have_unit_length():
    normals = vertex_normals(CUBE, FACES)
    torch.testing.assert_close(normals.norm(dim=-1), torch.ones(8))
    assert ((normals * (CUBE - 0.5)).sum(-1) > 0).all()


def test_normals_turn_with_the_surface_and_do_not_know_where_it_is():
    turn = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = vertex_normals(CUBE @ turn.T + 5, FACES)
    torch.testing.assert_close(moved, vertex_normals(CUBE, FACES) @ turn.T, atol=1e-6, rtol=0)


def test_a_vertex_that_no_triangle_uses_has_no_normal_and_no_height(body):
    lonely = torch.cat([CUBE, torch.tensor([[9.0, 9.0, 9.0]])])
    projection = closest_points(lonely[-1:] + 0.1, lonely, FACES)
    assert projection.heights(lonely[-1:] + 0.1).tolist() == [0.0]


def test_heights_are_along_the_normal_positive_outside(body):
    normals = vertex_normals(body.vertices, body.faces)
    offsets = torch.tensor([0.004, -0.003])[torch.arange(len(body.vertices)) % 2]
    means = body.vertices + offsets[:, None] * normals
    heights = closest_points(body.vertices, body.vertices, body.faces).heights(means)
    torch.testing.assert_close(heights, offsets, atol=5e-4, rtol=0)  # some vertices coincide


def test_sliding_along_the_surface_changes_no_height():
    projection = closest_points(CUBE, CUBE, FACES)
    across = torch.linalg.cross(projection.normals, torch.tensor([[0.3, 0.5, 0.7]]).expand(8, 3))
    heights = projection.heights(CUBE + 0.2 * across)
    torch.testing.assert_close(heights, torch.zeros(8), atol=1e-6, rtol=0)


def test_heights_pull_means_along_the_normal():
    means = (CUBE + 0.1).requires_grad_()
    projection = closest_points(means, CUBE, FACES)
    projection.heights(means).sum().backward()
    torch.testing.assert_close(means.grad, projection.normals)
