import pytest
import torch

from deblur_avatar.geometry.cameras import Camera, look_at
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.rendering import normal_maps as module
from deblur_avatar.rendering.normal_maps import seen_normals, seen_places, seen_places_reference
from tests.missing_compiler import check_a_warning_without_a_compiler
from tests.randomness import seeded

BOTH = pytest.mark.parametrize("places", [seen_places, seen_places_reference])

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
    return torch.ones(1, 12, 12, dtype=torch.bool)


def only(*pixels):
    """Those columns and rows."""
    asked = torch.zeros(1, 12, 12, dtype=torch.bool)
    for column, row in pixels:
        asked[0, row, column] = True
    return asked


def seen_by(vertices, normals, faces, camera, asked):
    """At one instant."""
    return seen_normals(vertices[None], normals[None], faces, camera, asked)


def towards(direction, count=4):
    return torch.tensor(direction).expand(count, 3)


def test_a_square_is_met_in_the_pixels_that_it_covers():
    met, seen = seen_by(SQUARE, towards([0.0, 0, 1]), FACES, camera(), every_pixel())
    wanted = torch.zeros(1, 12, 12, dtype=torch.bool)
    wanted[0, 3:9, 3:9] = True
    assert torch.equal(met, wanted)
    torch.testing.assert_close(seen, FORWARD.expand(36, 3))


def test_pixels_are_columns_and_rows_seen_through_their_middles():
    corner = SQUARE.clone()
    corner[:, :2] = SQUARE[:, :2] / 3 + torch.tensor([1.0, 0.0])  # columns 8 to 9, rows 5 to 6
    asked = only([8, 5], [9, 6], [7, 5], [10, 6], [5, 8], [8, 4])
    met, _ = seen_by(corner, towards([0.0, 0, 1]), FACES, camera(), asked)
    assert torch.equal(met, only([8, 5], [9, 6]))


def test_normals_run_from_vertex_to_vertex_at_unit_length():
    left, right = torch.tensor([-1.0, 0, 1]), torch.tensor([1.0, 0, 1])
    normals = torch.stack([left, right, right, left]) / 2**0.5
    row = only(*([column, 6] for column in range(3, 9)))
    _, seen = seen_by(SQUARE, normals, FACES, camera(), row)
    across = (torch.arange(6) + 0.5) / 3 - 1  # x of the pixels' middles on the square
    wanted = torch.nn.functional.normalize(
        torch.stack([across, torch.zeros(6), torch.ones(6)], dim=1), dim=1
    )
    torch.testing.assert_close(seen * torch.tensor([1.0, -1, -1]), wanted, atol=1e-5, rtol=0)


@BOTH
def test_the_nearer_surface_is_seen_whatever_the_order_of_faces(places):
    both = torch.cat([SQUARE, SQUARE + torch.tensor([0.0, 0, 1])])
    faces = torch.cat([FACES, FACES + 4])
    assert (places(both, faces, camera()).triangle[4:8, 4:8] >= 2).all()
    assert (places(both, faces.flip(0), camera()).triangle[4:8, 4:8] < 2).all()


def test_normals_are_in_the_cameras_axes():
    turn = axis_angle_to_matrix(torch.tensor([0.2, 0.5, -0.3]))
    normals = torch.nn.functional.normalize(SQUARE + torch.tensor([0.1, 0.2, 1.0]), dim=1)
    eye = camera()
    moved = torch.eye(4)
    moved[:3, :3] = turn.T
    along = Camera(K, eye.viewmat @ moved, 12, 12)  # world and camera turn together
    here = seen_by(SQUARE, normals, FACES, eye, every_pixel())
    there = seen_by(SQUARE @ turn.T, normals @ turn.T, FACES, along, every_pixel())
    assert torch.equal(here[0], there[0])
    torch.testing.assert_close(here[1], there[1], atol=1e-4, rtol=0)
    aside = seen_by(SQUARE, normals, FACES, camera((2.0, 0.0, 3.5)), only([6, 6]))
    one = seen_by(SQUARE, normals, FACES, eye, only([6, 6]))
    assert (aside[1] - one[1]).abs().max() > 0.1


def test_no_pixel_and_no_hit_are_answered_with_nothing():
    for asked in (only(), only([0, 0], [11, 11])):
        met, seen = seen_by(SQUARE, towards([0.0, 0, 1]), FACES, camera(), asked)
        assert not met.any()
        assert seen.shape == (0, 3)


def test_instants_have_meshes_normals_and_pixels_of_their_own():
    smaller = 0.4 * SQUARE
    normals = torch.stack([towards([0.0, 0, 1]), towards([0.0, 1, 0])])
    asked = torch.cat([only([4, 4], [6, 6]), every_pixel()])
    met, seen = seen_normals(torch.stack([SQUARE, smaller]), normals, FACES, camera(), asked)
    assert met.flatten(1).sum(1).tolist() == [2, 4]
    alone = [
        seen_by(vertices, own, FACES, camera(), one[None])
        for vertices, own, one in zip((SQUARE, smaller), normals, asked, strict=True)
    ]
    assert torch.equal(met, torch.cat([one[0] for one in alone]))
    assert torch.equal(seen, torch.cat([one[1] for one in alone]))


def test_the_gradient_is_of_normals_and_not_of_places():
    generator = torch.Generator().manual_seed(0)
    normals = torch.randn(4, 3, generator=generator, dtype=torch.float64).requires_grad_()
    vertices = SQUARE.clone().requires_grad_()

    def seen(normals):
        return seen_by(vertices, normals, FACES, camera(), only([4, 4], [7, 5], [8, 8]))[1]

    assert torch.autograd.gradcheck(seen, (normals,))
    seen(normals).sum().backward()
    assert vertices.grad is None


def test_the_kernel_sees_what_rays_see(body):
    vertices = body.vertices + 3e-3 * torch.randn(body.vertices.shape, generator=seeded())
    middle = vertices.mean(0)
    up = torch.tensor([0.0, 1.0, 0.0])
    for turn, away in ((0.0, 2.5), (2.0, 2.5), (4.0, 0.8)):  # the last one sees a part of it
        angle = torch.tensor(turn)
        eye = middle + away * torch.stack([angle.sin(), torch.tensor(0.2), angle.cos()])
        K = torch.tensor([[150.0, 3, 70], [0, 160, 60], [0, 0, 1]])
        one = Camera(K, look_at(eye, middle, up), 140, 120)
        fast, slow = (
            see(vertices, body.faces, one) for see in (seen_places, seen_places_reference)
        )
        same = fast.triangle == slow.triangle
        assert (slow.triangle >= 0).sum() > 1000
        assert (~same).sum() <= 0.002 * (slow.triangle >= 0).sum()  # where a ray meets an edge
        met = same & (slow.triangle >= 0)
        for name in ("u", "v"):
            torch.testing.assert_close(
                getattr(fast, name)[met], getattr(slow, name)[met], atol=2e-3, rtol=0
            )


@BOTH
def test_along_the_edge_of_two_triangles_nothing_is_missing(places):
    # The square's diagonal goes through pixels' middles.
    assert (places(SQUARE, FACES, camera()).triangle[3:9, 3:9] >= 0).all()


@BOTH
def test_a_mesh_behind_the_camera_or_without_faces_is_not_seen(places):
    behind = SQUARE + torch.tensor([0.0, 0, 9])
    for vertices, faces in (
        (behind, FACES),
        (SQUARE, FACES[:0]),
        (SQUARE[:, :1].expand(4, 3), FACES),
    ):
        assert (places(vertices.contiguous(), faces, camera()).triangle == -1).all()


def test_it_is_the_kernel_that_looks(monkeypatch):
    monkeypatch.setattr(module, "cast_rays", None)
    seen_places(SQUARE, FACES, camera())


def test_without_a_compiler_rays_look(monkeypatch):
    check_a_warning_without_a_compiler(module, monkeypatch)
    monkeypatch.setattr(module, "_library", lambda: None)
    found = seen_places(SQUARE, FACES, camera())
    assert torch.equal(found.triangle, seen_places_reference(SQUARE, FACES, camera()).triangle)
