import pytest
import torch

from deblur_avatar.avatars.body_distance import (
    MARGIN,
    KnownDistances,
    distances_all_over,
    distances_near,
    inside,
    outer_surface,
    signed_distances,
)
from tests.randomness import seeded


def boxes(*sides):
    """Cubes round the origin, one in the other or through each other."""
    corners = torch.tensor([[x, y, z] for x in (-1.0, 1) for y in (-1, 1) for z in (-1, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = torch.tensor([half for a, b, c, d in quads for half in ((a, b, c), (a, c, d))])
    vertices = [shift + side / 2 * corners for side, shift in sides]
    return torch.cat(vertices), torch.cat([faces + 8 * i for i in range(len(sides))])


CUBE = (2.0, torch.zeros(3))


def test_points_are_inside_that_a_closed_mesh_holds():
    vertices, faces = boxes(CUBE)
    points = 3 * torch.rand(200, 3, generator=seeded()) - 1.5
    assert torch.equal(inside(points, vertices, faces), (points.abs() < 1).all(1))


def test_points_are_inside_where_parts_overlap():
    vertices, faces = boxes(CUBE, (1.0, torch.tensor([0.8, 0.0, 0.0])))
    points = 3 * torch.rand(300, 3, generator=seeded()) - 1.5
    second = ((points - torch.tensor([0.8, 0.0, 0.0])).abs() < 0.5).all(1)
    assert torch.equal(inside(points, vertices, faces), (points.abs() < 1).all(1) | second)


def test_distances_are_those_from_the_surface_negative_inside():
    vertices, faces = boxes(CUBE)
    points = torch.tensor([[0.0, 0.0, 0.0], [0.7, 0.0, 0.1], [1.4, 0.0, 0.0], [2.0, 2.0, 2.0]])
    wanted = torch.tensor([-1.0, -0.3, 0.4, 3**0.5])
    torch.testing.assert_close(signed_distances(points, vertices, faces), wanted, atol=0.02, rtol=0)


def test_surfaces_within_another_part_do_not_count():
    vertices, faces = boxes(CUBE, (1.0, torch.tensor([0.8, 0.0, 0.0])))
    outer = outer_surface(vertices, faces, 3000, seeded())
    held = (outer.abs() < 0.99).all(1)  # of the small cube, within the large one
    apart = ((outer - torch.tensor([0.8, 0.0, 0.0])).abs() < 0.49).all(1)
    assert not held.any()
    assert not apart.any()
    assert 2000 < len(outer) < 2990
    point = torch.tensor([[0.4, 0.0, 0.0]])  # 10 cm from the small cube's inner side
    assert float(signed_distances(point, vertices, faces)) == pytest.approx(-0.78, abs=0.03)


def test_the_body_itself_is_inside_out_nowhere(body):
    middles = (body.joints[1] + body.joints[4]) / 2
    found = signed_distances(
        torch.stack([middles, middles + torch.tensor([0.0, 0.0, 0.5])]), body.vertices, body.faces
    )
    assert float(found[0]) == pytest.approx(-0.075, abs=0.01)  # a thigh's radius
    assert float(found[1]) == pytest.approx(0.425, abs=0.01)


def test_points_all_over_fill_the_box_and_are_the_same_each_time(body):
    known = distances_all_over(body.vertices, body.faces, 500)
    again = distances_all_over(body.vertices, body.faces, 500)
    assert torch.equal(known.points, again.points)
    assert torch.equal(known.distances, again.distances)
    low, high = known.points.amin(0), known.points.amax(0)
    torch.testing.assert_close(low, body.vertices.amin(0) - MARGIN, atol=0.05, rtol=0)
    torch.testing.assert_close(high, body.vertices.amax(0) + MARGIN, atol=0.05, rtol=0)


def test_points_near_the_surface_are_near_and_on_both_sides(body):
    known = distances_near(body.vertices, body.faces, 500, seeded())
    assert known.distances.abs().quantile(0.9) < 0.1
    assert 0.2 < (known.distances < 0).float().mean() < 0.7
    spread = known.distances.abs().mean()
    assert 0.01 < spread < 0.06


def test_some_are_drawn_by_the_generator_with_their_distances():
    known = KnownDistances(torch.arange(12.0).reshape(4, 3), torch.arange(4.0))
    some = known.some(9, seeded())
    assert torch.equal(some.points[:, 0], 3 * some.distances)
    assert len(some.points) == 9
    assert torch.equal(some.points, known.some(9, seeded()).points)
    assert not torch.equal(some.points, known.some(9, seeded(1)).points)
