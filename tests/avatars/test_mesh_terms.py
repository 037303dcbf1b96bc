import pytest
import torch

from deblur_avatar.avatars.mesh_terms import (
    adjacent_faces,
    color_consistency,
    laplacian,
    mesh_edges,
    normal_consistency,
)
from deblur_avatar.geometry.rotations import axis_angle_to_matrix

pytestmark = pytest.mark.portable

TETRAHEDRON = torch.tensor([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
CORNERS = torch.tensor([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
SQUARE = torch.tensor([[0, 1, 2], [0, 2, 3]])
NONE = torch.zeros(0, 2, dtype=torch.long)


def hexagon():
    """Six equilateral faces about one vertex, wound alike."""
    angles = torch.arange(6) * torch.pi / 3
    rim = torch.stack([angles.cos(), angles.sin(), 0 * angles], dim=1)
    faces = torch.tensor([[0, 1 + i, 1 + (i + 1) % 6] for i in range(6)])
    return torch.cat([torch.zeros(1, 3), rim]), faces


def folded(angle):
    """A square folded along its diagonal by an angle."""
    a, b, c = torch.tensor([[0.0, 0, 0], [1, -1, 0], [2, 0, 0]])
    angle = torch.as_tensor(angle, dtype=torch.float32)
    d = torch.stack([torch.tensor(1.0), angle.cos(), angle.sin()])
    return torch.stack([a, b, c, d])[None]


def test_each_edge_is_there_once_the_lower_vertex_first():
    edges = mesh_edges(TETRAHEDRON).tolist()
    assert edges == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]
    assert len(mesh_edges(hexagon()[1])) == 12


def test_faces_are_adjacent_where_they_share_an_edge():
    pairs = {tuple(sorted(pair)) for pair in adjacent_faces(TETRAHEDRON).tolist()}
    assert pairs == {(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)}
    assert adjacent_faces(SQUARE).tolist() == [[0, 1]]
    around = {tuple(sorted(pair)) for pair in adjacent_faces(hexagon()[1]).tolist()}
    assert around == {(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (0, 5)}
    assert adjacent_faces(SQUARE[:1]).shape == (0, 2)


def test_three_faces_about_one_edge_are_two_pairs():
    fan = torch.tensor([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert adjacent_faces(fan).tolist() == [[0, 1], [1, 2]]


def test_the_body_is_closed(body):
    edges, pairs = mesh_edges(body.faces), adjacent_faces(body.faces)
    assert 2 * len(edges) == 3 * len(body.faces)
    assert len(pairs) == len(edges)
    assert (pairs[:, 0] != pairs[:, 1]).all()


def test_the_middle_of_a_regular_patch_has_no_laplacian_and_a_shift_of_it_has():
    vertices, faces = hexagon()
    edges = mesh_edges(faces)
    # Of the seven vertices those of the rim are off: half a neighbour's distance, one by one.
    rim = sum(
        (vertices[[0, 1 + (i + 1) % 6, 1 + (i - 1) % 6]].mean(0) - vertices[1 + i]).square().sum()
        for i in range(6)
    )
    torch.testing.assert_close(laplacian(vertices[None], edges), rim / 7)
    lifted = vertices.clone()
    lifted[0, 2] = 0.5  # the middle by all of it, each of the rim by a third
    more = (0.5**2 + 6 * (0.5 / 3) ** 2) / 7
    torch.testing.assert_close(laplacian(lifted[None], edges), rim / 7 + more)


def test_the_laplacian_of_a_tetrahedron_by_hand():
    # The middle of the others is at minus a third of a corner, 4/3 of its length 3 ** .5 away.
    found = laplacian(CORNERS[None], mesh_edges(TETRAHEDRON))
    torch.testing.assert_close(found, torch.tensor(16 / 9 * 3))


def test_a_vertex_of_no_face_weighs_nothing():
    alone = torch.cat([CORNERS, torch.tensor([[9.0, 9, 9]])])[None]
    found = laplacian(alone, mesh_edges(TETRAHEDRON))
    torch.testing.assert_close(found, torch.tensor(16 / 9 * 3 * 4 / 5))


@pytest.mark.parametrize("angle", [0.0, 0.5, 2.0])
def test_a_fold_costs_one_less_the_cosine_of_its_angle(angle):
    found = normal_consistency(folded(angle), SQUARE, adjacent_faces(SQUARE))
    torch.testing.assert_close(found, 1 - torch.tensor(angle).cos(), atol=1e-6, rtol=0)


def test_size_does_not_count_as_a_fold():
    pairs = adjacent_faces(SQUARE)
    once, small = folded(0.7), 1e-2 * folded(0.7)
    torch.testing.assert_close(
        normal_consistency(once, SQUARE, pairs), normal_consistency(small, SQUARE, pairs)
    )


def test_moving_the_whole_mesh_changes_no_term_and_instants_count_alike():
    pairs, edges = adjacent_faces(TETRAHEDRON), mesh_edges(TETRAHEDRON)
    turn = axis_angle_to_matrix(torch.tensor([0.5, 1.0, -0.2]))
    crooked = CORNERS + 0.3 * torch.randn(4, 3, generator=torch.Generator().manual_seed(0))
    moved = crooked @ turn.T + torch.tensor([1.0, 2, 3])
    other = CORNERS * torch.tensor([1.0, 2, 3])
    both = torch.stack([crooked, other])
    for term in (
        lambda v: laplacian(v, edges),
        lambda v: normal_consistency(v, TETRAHEDRON, pairs),
    ):
        torch.testing.assert_close(term(crooked[None]), term(moved[None]), atol=1e-5, rtol=1e-4)
        torch.testing.assert_close(term(both), (term(crooked[None]) + term(other[None])) / 2)


def test_colours_cost_their_mean_difference_from_neighbours():
    colors = torch.tensor([[0.0, 0.5, 1.0], [0.3, 0.5, 0.4], [9.0, 9.0, 9.0]])
    found = color_consistency(colors, torch.tensor([[0, 1]]))
    torch.testing.assert_close(found, torch.tensor((0.3 + 0.0 + 0.6) / 3))


def test_faces_without_neighbours_cost_nothing():
    assert normal_consistency(folded(1.0), SQUARE[:1], NONE) == 0
    assert color_consistency(torch.rand(1, 3), NONE) == 0


def test_gradients_and_a_face_without_area():
    vertices = (CORNERS + 0.1).double()[None].requires_grad_()
    pairs, edges = adjacent_faces(TETRAHEDRON), mesh_edges(TETRAHEDRON)
    assert torch.autograd.gradcheck(lambda v: laplacian(v, edges), (vertices,))
    assert torch.autograd.gradcheck(
        lambda v: normal_consistency(v, TETRAHEDRON, pairs), (vertices,)
    )
    flat = torch.zeros(1, 4, 3, requires_grad=True)
    normal_consistency(flat, TETRAHEDRON, pairs).backward()
    assert torch.isfinite(flat.grad).all()
