import torch

from deblur_avatar.rendering.covariances import (
    covariances,
    upper_triangles,
    whole_matrices,
)


def some_quats(n: int) -> torch.Tensor:
    return torch.randn(n, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def test_without_rotation_the_variances_lie_on_the_diagonal():
    quats = torch.tensor([[1.0, 0, 0, 0]])
    found = covariances(quats, torch.tensor([[1.0, 2, 3]]))
    torch.testing.assert_close(found, torch.diag(torch.tensor([1.0, 4, 9]))[None])


def test_a_quarter_turn_about_z_carries_x_to_y():
    half = 0.5**0.5
    found = covariances(torch.tensor([[half, 0, 0, half]]), torch.tensor([[3.0, 1, 1]]))
    torch.testing.assert_close(found, torch.diag(torch.tensor([1.0, 9, 1]))[None])


def test_rotation_keeps_the_standard_deviations():
    scales = torch.rand(20, 3, dtype=torch.float64) + 0.1
    eigenvalues = torch.linalg.eigvalsh(covariances(some_quats(20), scales))
    torch.testing.assert_close(eigenvalues, scales.square().sort(dim=-1).values)


def test_length_and_sign_of_a_quaternion_are_invisible():
    quats, scales = some_quats(5), torch.rand(5, 3, dtype=torch.float64)
    torch.testing.assert_close(covariances(-3 * quats, scales), covariances(quats, scales))


def test_six_numbers_and_a_symmetric_matrix_say_the_same():
    covars = covariances(some_quats(5), torch.rand(5, 3, dtype=torch.float64))
    six = upper_triangles(covars)
    torch.testing.assert_close(six[0], covars[0][(0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)])
    torch.testing.assert_close(whole_matrices(six), covars)


def test_gradients_are_right():
    quats = some_quats(3).requires_grad_()
    scales = (torch.rand(3, 3, dtype=torch.float64) + 0.1).requires_grad_()
    assert torch.autograd.gradcheck(covariances, (quats, scales))
