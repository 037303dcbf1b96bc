import pytest
import torch

from deblur_avatar.geometry.cameras import Camera, look_at
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.rendering.normal_maps import seen_normals

pytestmark = pytest.mark.portable

# A square of side 2 in the plane z = 0, and a camera 4 m in front of it that sees it 6 pixels wide.
SQUARE = torch.tensor([[-1.0, -1, 0], [1.0, -1, 0], [1.0, 1, 0], [-1.0, 1, 0]])
FACES = torch.tensor([[0, 1, 2], [0, 2, 3]])
K = torch.tensor([[12.0, 0, 6], [0, 12, 6], [0, 0, 1]])
FORWARD = torch.tensor([0.0, 0, -1])  # towards the camera, in the camera's axes


def camera(eye=(0.0, 0.0, 4.0)):
    up = torch.tensor([0.0, 1.0, 0.0])
    return Camera(K, look_at(torch.tensor(eye), torch.zeros(3), up), 12, 12)


def every_pixel():
    grid = torch.meshgrid(torch.arange(12), torch.arange(12), indexing="xy")
    return torch.stack(grid, dim=-1).flatten(0, 1)


def towards(direction, count=4):
    return torch.tensor(direction).expand(count, 3)


def test_a_square_is_met_in_the_pixels_that_it_covers():
    met, seen = seen_normals(SQUARE, towards([0.0, 0, 1]), FACES, camera(), every_pixel())
    wanted = torch.zeros(12, 12, dtype=torch.bool)
    wanted[3:9, 3:9] = True
    assert torch.equal(met.unflatten(0, (12, 12)), wanted)
    torch.testing.assert_close(seen, FORWARD.expand(36, 3))


def test_pixels_are_columns_and_rows_seen_through_their_middles():
    corner = SQUARE.clone()
    corner[:, :2] = SQUARE[:, :2] / 3 + torch.tensor([1.0, 0.0])  # columns 8 to 9, rows 5 to 6
    asked = torch.tensor([[8, 5], [9, 6], [7, 5], [10, 6], [5, 8], [8, 4]])
    met, _ = seen_normals(corner, towards([0.0, 0, 1]), FACES, camera(), asked)
    assert met.tolist() == [True, True, False, False, False, False]


def test_normals_run_from_vertex_to_vertex_at_unit_length():
    left, right = torch.tensor([-1.0, 0, 1]), torch.tensor([1.0, 0, 1])
    normals = torch.stack([left, right, right, left]) / 2**0.5
    row = torch.tensor([[column, 6] for column in range(3, 9)])
    _, seen = seen_normals(SQUARE, normals, FACES, camera(), row)
    across = (torch.arange(6) + 0.5) / 3 - 1  # x of the pixels' middles on the square
    wanted = torch.nn.functional.normalize(
        torch.stack([across, torch.zeros(6), torch.ones(6)], dim=1), dim=1
    )
    torch.testing.assert_close(seen * torch.tensor([1.0, -1, -1]), wanted, atol=1e-5, rtol=0)


def test_the_nearer_surface_is_seen():
    both = torch.cat([SQUARE, SQUARE + torch.tensor([0.0, 0, 1])])
    normals = torch.cat([towards([0.0, 1, 0]), towards([0.0, 0, 1])])
    faces = torch.cat([FACES, FACES + 4])
    _, seen = seen_normals(both, normals, faces, camera(), torch.tensor([[6, 6]]))
    torch.testing.assert_close(seen[0], FORWARD)


def test_normals_are_in_the_cameras_axes():
    turn = axis_angle_to_matrix(torch.tensor([0.2, 0.5, -0.3]))
    normals = torch.nn.functional.normalize(SQUARE + torch.tensor([0.1, 0.2, 1.0]), dim=1)
    eye = camera()
    moved = torch.eye(4)
    moved[:3, :3] = turn.T
    along = Camera(K, eye.viewmat @ moved, 12, 12)  # world and camera turn together
    here = seen_normals(SQUARE, normals, FACES, eye, every_pixel())
    there = seen_normals(SQUARE @ turn.T, normals @ turn.T, FACES, along, every_pixel())
    assert torch.equal(here[0], there[0])
    torch.testing.assert_close(here[1], there[1], atol=1e-4, rtol=0)
    aside = seen_normals(SQUARE, normals, FACES, camera((2.0, 0.0, 3.5)), torch.tensor([[6, 6]]))
    one = seen_normals(SQUARE, normals, FACES, eye, torch.tensor([[6, 6]]))
    assert (aside[1] - one[1]).abs().max() > 0.1


def test_no_pixel_and_no_hit_are_answered_with_nothing():
    for asked in (torch.zeros(0, 2, dtype=torch.long), torch.tensor([[0, 0], [11, 11]])):
        met, seen = seen_normals(SQUARE, towards([0.0, 0, 1]), FACES, camera(), asked)
        assert met.tolist() == [False] * len(asked)
        assert seen.shape == (0, 3)


def test_the_gradient_is_of_normals_and_not_of_places():
    generator = torch.Generator().manual_seed(0)
    normals = torch.randn(4, 3, generator=generator, dtype=torch.float64).requires_grad_()
    vertices = SQUARE.clone().requires_grad_()
    asked = torch.tensor([[4, 4], [7, 5], [8, 8]])

    def seen(normals):
        return seen_normals(vertices, normals, FACES, camera(), asked)[1]

    assert torch.autograd.gradcheck(seen, (normals,))
    seen(normals).sum().backward()
    assert vertices.grad is None
