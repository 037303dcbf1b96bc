import pytest
import torch
from kornia.geometry import conversions
from scipy.spatial.transform import Rotation

from deblur_avatar.geometry.rotations import (
    axis_angle_to_matrix,
    axis_angle_to_quat,
    matrix_to_axis_angle,
    matrix_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
    quat_to_matrix,
    slerp,
)

RANDOM = torch.randn(50, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
RANDOM = RANDOM * (3 / RANDOM.norm(dim=-1, keepdim=True).clamp(min=3))  # angles below pi
EDGES = torch.tensor(
    [[0, 0, 0], [1e-9, 0, 0], [0, 3e-5, 0], [0, 0, 3.14159], [3.1415, 0, 0], [1e-4, 1e-4, 0]],
    dtype=torch.float64,
)


@pytest.mark.parametrize("axis_angle", [RANDOM, EDGES])
def test_conversions_are_kornias(axis_angle):
    quats = axis_angle_to_quat(axis_angle)
    matrices = axis_angle_to_matrix(axis_angle)
    for own, kornias in (
        (quats, conversions.axis_angle_to_quaternion(axis_angle)),
        (quat_to_axis_angle(quats), conversions.quaternion_to_axis_angle(quats)),
        (quat_to_matrix(quats), conversions.quaternion_to_rotation_matrix(quats)),
        (matrices, conversions.axis_angle_to_rotation_matrix(axis_angle)),
    ):
        torch.testing.assert_close(own, kornias, atol=1e-9, rtol=0)


@pytest.mark.parametrize("axis_angle", [RANDOM, EDGES])
def test_matrices_agree_with_scipy(axis_angle):
    expected = torch.tensor(Rotation.from_rotvec(axis_angle.numpy()).as_matrix())
    torch.testing.assert_close(axis_angle_to_matrix(axis_angle), expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize("axis_angle", [RANDOM, EDGES])
def test_every_spelling_leads_back_to_the_first(axis_angle):
    quats = axis_angle_to_quat(axis_angle)
    torch.testing.assert_close(quat_to_axis_angle(quats), axis_angle, atol=1e-9, rtol=0)
    matrices = quat_to_matrix(quats)
    torch.testing.assert_close(matrix_to_axis_angle(matrices), axis_angle, atol=1e-7, rtol=0)


def test_half_turns_about_any_axis_survive_the_matrix():
    axes = torch.nn.functional.normalize(RANDOM, dim=-1) * torch.pi
    matrices = axis_angle_to_matrix(axes)
    again = quat_to_matrix(matrix_to_quat(matrices))
    torch.testing.assert_close(again, matrices, atol=1e-12, rtol=0)


def test_products_of_quaternions_are_products_of_matrices():
    a, b = axis_angle_to_quat(RANDOM[:20]), axis_angle_to_quat(RANDOM[20:40])
    product = quat_to_matrix(quat_multiply(a, b))
    torch.testing.assert_close(product, quat_to_matrix(a) @ quat_to_matrix(b))
    one = quat_multiply(a, quat_conjugate(a))
    torch.testing.assert_close(one, torch.tensor([1.0, 0, 0, 0]).double().expand(20, 4))


def test_gradients_are_exact_at_the_identity_too():
    still = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(axis_angle_to_matrix, still)
    moving = RANDOM[:3].clone().requires_grad_()
    assert torch.autograd.gradcheck(axis_angle_to_matrix, moving)
    assert torch.autograd.gradcheck(lambda x: quat_to_axis_angle(axis_angle_to_quat(x)), (moving,))


def test_slerp_starts_at_the_start_and_ends_at_the_end_at_constant_speed():
    start, end = axis_angle_to_quat(RANDOM[:10]), axis_angle_to_quat(RANDOM[10:20])
    u = torch.linspace(0, 1, 5, dtype=torch.float64)
    path = quat_to_matrix(slerp(start, end, u))
    torch.testing.assert_close(path[0], quat_to_matrix(start))
    torch.testing.assert_close(path[-1], quat_to_matrix(end))
    steps = matrix_to_axis_angle(path[:-1].mT @ path[1:]).norm(dim=-1)
    torch.testing.assert_close(steps, steps[:1].expand_as(steps))


def test_slerp_does_not_care_which_of_two_quaternions_spells_a_rotation():
    start, end = axis_angle_to_quat(RANDOM[:10]), axis_angle_to_quat(RANDOM[10:20])
    u = torch.tensor([0.3], dtype=torch.float64)
    torch.testing.assert_close(
        quat_to_matrix(slerp(start, -end, u)), quat_to_matrix(slerp(start, end, u))
    )


def test_slerp_between_equal_poses_shares_its_gradient_by_the_weights():
    start = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    end = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    u = torch.tensor([0.25], dtype=torch.float64)
    middle = quat_to_axis_angle(slerp(axis_angle_to_quat(start), axis_angle_to_quat(end), u))
    middle.sum().backward()
    torch.testing.assert_close(start.grad, torch.full((3,), 0.75, dtype=torch.float64))
    torch.testing.assert_close(end.grad, torch.full((3,), 0.25, dtype=torch.float64))
