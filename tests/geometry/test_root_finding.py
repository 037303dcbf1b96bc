import pytest
import torch

from deblur_avatar.geometry.root_finding import Roots, broyden


def still(start):
    return torch.eye(start.shape[1]).expand(len(start), -1, -1)


def circle_and_line(values, rows):
    """x^2 + y^2 = 2 and y = x."""
    x, y = values.unbind(1)
    return torch.stack([(x.square() + y.square() - 2) / 2, y - x], dim=1)


def test_it_finds_roots_of_equations_that_are_not_linear():
    start = torch.tensor([[1.3, 0.8], [0.7, 1.2]])
    roots = broyden(circle_and_line, start, still(start), 30, 1e-6)
    torch.testing.assert_close(roots.values, torch.ones(2, 2), atol=1e-5, rtol=0)
    assert roots.residuals.max() < 1e-6


def test_linear_equations_with_their_inverse_take_one_step():
    matrix = torch.tensor([[3.0, 1.0], [1.0, 2.0]])
    start = torch.zeros(1, 2)
    wanted = torch.tensor([[0.4, -0.3]])
    roots = broyden(
        lambda values, rows: (values - wanted) @ matrix.T, start, matrix.inverse()[None], 1, 1e-6
    )
    torch.testing.assert_close(roots.values, wanted)


def test_the_matrix_learns_so_that_a_wrong_one_does():
    matrix = torch.tensor([[3.0, 1.0], [1.0, 2.0]])
    wanted, start = torch.tensor([[0.4, -0.3]]), torch.zeros(1, 2)
    roots = broyden(
        lambda values, rows: (values - wanted) @ matrix.T, start, 0.2 * still(start), 8, 1e-5
    )
    torch.testing.assert_close(roots.values, wanted, atol=1e-4, rtol=0)


def test_systems_are_told_by_their_numbers_and_rest_once_they_are_solved():
    targets, asked = torch.tensor([[0.0], [1.0], [8.0]]), []

    def equations(values, rows):
        asked.append(rows.tolist())
        return (values - targets[rows]) ** 3 / 4 + values - targets[rows]

    start = torch.zeros(3, 1)
    roots = broyden(equations, start, still(start), 25, 1e-6)
    torch.testing.assert_close(roots.values, targets, atol=1e-5, rtol=0)
    assert asked[0] == [0, 1, 2]
    assert asked[1] == [1, 2]
    assert [2] in asked


def test_the_best_that_was_met_is_kept():
    def worse(values, rows):
        return 1 + values.square()  # no root

    start = torch.tensor([[0.0]])
    roots = broyden(worse, start, still(start), 5, 1e-6)
    assert float(roots.residuals) == pytest.approx(1.0)
    assert float(roots.values) == 0.0


def test_what_is_no_number_is_never_the_best():
    def odd(values, rows):
        return torch.where(values > 0, torch.full_like(values, torch.nan), values + 1)

    start = torch.tensor([[-0.5]])
    roots = broyden(odd, start, -4 * still(start), 3, 1e-6)
    assert float(roots.values) == -0.5
    assert float(roots.residuals) == 0.5


def test_no_gradient_flows_through_a_search():
    start = torch.tensor([[1.3, 0.8]], requires_grad=True)
    assert not broyden(circle_and_line, start, still(start), 3, 1e-6).values.requires_grad


def test_the_better_of_two_roots_is_taken_system_by_system():
    one = Roots(torch.tensor([[1.0], [1.0]]), torch.tensor([0.1, torch.inf]))
    other = Roots(torch.tensor([[2.0], [2.0]]), torch.tensor([0.2, 0.3]))
    both = one.or_better(other)
    assert both.values.tolist() == [[1.0], [2.0]]
    assert both.residuals.tolist() == pytest.approx([0.1, 0.3])
