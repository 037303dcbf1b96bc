import math

import pytest
import torch

from deblur_avatar.avatars.mesh_gaussians import (
    MeshGaussians,
    face_gaussians,
    steiner_frames,
)
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.rendering.covariances import whole_matrices
from tests.randomness import seeded

pytestmark = pytest.mark.portable

THICKNESS = 1e-3
FACE = torch.tensor([[0, 1, 2]])


def equilateral(radius=0.02, dtype=torch.float64):
    """About the origin in the plane z = 0."""
    angles = torch.arange(3, dtype=dtype) * 2 * math.pi / 3 + 0.3
    return radius * torch.stack([angles.cos(), angles.sin(), 0 * angles], dim=1)


def triangles(count=6, dtype=torch.float64):
    return 0.02 * torch.randn(count, 3, 3, generator=seeded(), dtype=dtype)


def gaussian(corners, shape=None):
    """Mean and covariance of the Gaussian on one face."""
    shape = torch.eye(3, dtype=corners.dtype) if shape is None else shape
    means, covars = face_gaussians(corners[None], FACE, shape[None], THICKNESS)
    return means[0, 0], whole_matrices(covars[0])[0]


def odd_shape(dtype=torch.float64):
    turn = axis_angle_to_matrix(torch.tensor([0.3, -0.2, 0.7], dtype=dtype))
    return turn * torch.tensor([1.5, 0.4, 0.8], dtype=dtype)


def test_on_an_equilateral_face_it_is_a_disc_as_wide_as_the_circumcircle():
    mean, covar = gaussian(equilateral(0.02))
    torch.testing.assert_close(mean, torch.zeros(3, dtype=torch.float64))
    wanted = torch.tensor([0.02, 0.02, THICKNESS], dtype=torch.float64).square().diag()
    torch.testing.assert_close(covar, wanted)


def test_on_any_face_its_ellipse_goes_through_the_corners():
    for corners in triangles():
        mean, covar = gaussian(corners)
        torch.testing.assert_close(mean, corners.mean(0))
        apart = corners - mean
        # The inertia of the corners is the Steiner ellipse's, but for a factor.
        normal = torch.nn.functional.normalize(
            torch.linalg.cross(apart[1] - apart[0], apart[2] - apart[0]), dim=0
        )
        wanted = 2 / 3 * apart.T @ apart + THICKNESS**2 * torch.outer(normal, normal)
        torch.testing.assert_close(covar, wanted)
        for corner in apart:
            assert float(corner @ torch.linalg.solve(covar, corner)) == pytest.approx(1.0)


def test_axes_are_at_right_angles_and_the_normal_as_long_as_it_is_thick():
    frames = steiner_frames(triangles(50), THICKNESS)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        products = (frames[..., one] * frames[..., other]).sum(-1)
        torch.testing.assert_close(products, torch.zeros_like(products), atol=1e-12, rtol=0)
    lengths = frames[..., 2].norm(dim=-1)
    torch.testing.assert_close(lengths, torch.full_like(lengths, THICKNESS))
    assert (frames[..., 0].norm(dim=-1) >= frames[..., 1].norm(dim=-1)).all()  # the longer first


def test_it_turns_and_moves_with_its_face_whatever_its_shape():
    turn = axis_angle_to_matrix(torch.tensor([1.0, -0.4, 2.0], dtype=torch.float64))
    shift = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    for corners in triangles():
        mean, covar = gaussian(corners, odd_shape())
        moved, turned = gaussian(corners @ turn.T + shift, odd_shape())
        torch.testing.assert_close(moved, turn @ mean + shift)
        torch.testing.assert_close(turned, turn @ covar @ turn.T)


def test_it_stretches_in_its_face_by_any_linear_map_and_keeps_its_thickness():
    stretch = torch.tensor([[2.0, 0.5, 0], [0.3, 0.7, 0], [0, 0, 1]], dtype=torch.float64)
    for corners in triangles():
        flat = corners * torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)
        before, after = gaussian(flat)[1], gaussian(flat @ stretch.T)[1]
        torch.testing.assert_close(after, stretch @ before @ stretch.T)


def test_a_face_three_times_as_large_has_a_gaussian_three_times_as_wide_whatever_its_shape():
    shape = torch.diag(torch.tensor([1.5, 0.4, 0.8], dtype=torch.float64))
    for corners in triangles():
        flat = corners * torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)
        before, after = gaussian(flat, shape)[1], gaussian(3 * flat, shape)[1]
        torch.testing.assert_close(after[:2, :2], 9 * before[:2, :2])
        torch.testing.assert_close(after[2, 2], before[2, 2])


def test_scales_are_of_the_faces_axes_and_turns_in_its_frame():
    corners = triangles(1)[0]
    frame = steiner_frames(corners, THICKNESS)
    long = gaussian(corners, torch.diag(torch.tensor([2.0, 1, 1], dtype=torch.float64)))[1]
    usual = gaussian(corners)[1]
    first = frame[:, 0]
    torch.testing.assert_close(long - usual, 3 * torch.outer(first, first))
    shape = odd_shape()
    torch.testing.assert_close(gaussian(corners, shape)[1], frame @ shape @ shape.T @ frame.T)


def test_a_mesh_starts_with_its_gaussians_as_large_as_its_faces_and_grey():
    mesh = MeshGaussians(triangles(2).flatten(0, 1), 7)
    assert torch.equal(mesh.shapes, torch.eye(3, dtype=torch.float64).expand(7, 3, 3))
    assert torch.equal(mesh.colors, torch.full((7, 3), 0.5, dtype=torch.float64))


def test_the_mesh_it_starts_on_stays_as_it_is():
    vertices = triangles(2).flatten(0, 1)
    before = vertices.clone()
    with torch.no_grad():
        MeshGaussians(vertices, 7).vertices.add_(1.0)
    assert torch.equal(vertices, before)


def test_shapes_are_turns_after_scales():
    mesh = MeshGaussians(torch.zeros(3, 3), 1)
    with torch.no_grad():
        mesh.turns.copy_(torch.tensor([[0.0, 0.0, math.pi / 2]]))  # x to y
        mesh.scales.copy_(torch.tensor([[2.0, 3.0, 4.0]]))
    wanted = torch.tensor([[0.0, -3, 0], [2, 0, 0], [0, 0, 4]])
    torch.testing.assert_close(mesh.shapes[0], wanted, atol=1e-6, rtol=0)


def test_instants_do_not_know_of_one_another():
    vertices = triangles(4, torch.float32).reshape(2, 6, 3)
    faces = torch.tensor([[0, 1, 2], [3, 5, 4], [1, 2, 5]])
    shapes = odd_shape(torch.float32).expand(3, 3, 3)
    together = face_gaussians(vertices, faces, shapes, THICKNESS)
    apart = [face_gaussians(one[None], faces, shapes, THICKNESS) for one in vertices]
    for index in range(2):
        torch.testing.assert_close(together[index], torch.cat([one[index] for one in apart]))
    assert [*together[0].shape] == [2, 3, 3]


def test_single_precision_is_as_good_as_faces_of_a_centimetre_on_a_person_need():
    corners = 0.5 * triangles(200) + torch.tensor([0.4, 1.2, 0.1], dtype=torch.float64)
    wide = face_gaussians(corners.reshape(1, -1, 3), torch.arange(600).reshape(-1, 3),
                          odd_shape().expand(200, 3, 3), THICKNESS)[1]  # fmt: skip
    narrow = face_gaussians(corners.float().reshape(1, -1, 3), torch.arange(600).reshape(-1, 3),
                            odd_shape().float().expand(200, 3, 3), THICKNESS)[1]  # fmt: skip
    assert (narrow - wide).abs().max() < 1e-3 * wide.abs().max()


def test_gradients_of_places_and_shapes():
    corners = triangles(2).reshape(1, 6, 3).requires_grad_()
    shapes = odd_shape().expand(2, 3, 3).clone().requires_grad_()
    faces = torch.arange(6).reshape(2, 3)
    assert torch.autograd.gradcheck(
        lambda v, s: face_gaussians(v, faces, s, THICKNESS), (corners, shapes), eps=1e-7
    )


@pytest.mark.parametrize(
    "corners",
    [
        equilateral(0.01, torch.float32),
        torch.zeros(3, 3),  # all in one place
        torch.tensor([[0.0, 0, 0], [0.01, 0, 0], [0.02, 0, 0]]),  # in a row
        torch.tensor([[0.0, 0, 0], [0.0, 0, 0], [0.01, 0, 0]]),  # two in one place
    ],
)
def test_round_and_flat_faces_have_finite_gaussians_and_gradients(corners):
    corners = corners.clone().requires_grad_()
    mean, covar = gaussian(corners, odd_shape(torch.float32))
    (mean.sum() + covar.sum()).backward()
    assert torch.isfinite(covar).all()
    assert torch.isfinite(corners.grad).all()
    assert torch.linalg.eigvalsh(covar.detach()).min() > -1e-9
    assert corners.grad.abs().max() < 10


def test_what_counts_as_round_or_flat_is_far_below_what_a_body_has():
    almost = equilateral(0.01)
    almost[0] += 1e-5  # a thousandth
    longer, shorter, _ = steiner_frames(almost, THICKNESS).T
    assert longer.norm() > shorter.norm() + 1e-6
    assert float(longer @ shorter) == pytest.approx(0.0, abs=1e-12)
    sliver = torch.tensor([[0.0, 0, 0], [0.01, 0, 0], [0.005, 1e-5, 0]])
    assert steiner_frames(sliver, THICKNESS)[2, 2].abs() == pytest.approx(THICKNESS)
