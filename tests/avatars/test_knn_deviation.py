import pytest
import torch

from deblur_avatar.avatars.knn_deviation import knn_deviation

pytestmark = pytest.mark.portable


def test_deviation_of_a_line_by_hand():
    values = torch.tensor([[0.0], [1.0], [3.0]])
    neighbours = torch.tensor([[1], [0], [1]])
    # Of {0, 1} twice and of {3, 1}: sqrt(1/2), sqrt(1/2), sqrt(2).
    wanted = (2 * 0.5**0.5 + 2**0.5) / 3
    torch.testing.assert_close(knn_deviation(values, neighbours), torch.tensor(wanted))


def test_it_is_the_unbiased_standard_deviation_of_a_neighbourhood():
    generator = torch.Generator().manual_seed(0)
    values = torch.randn(9, 4, generator=generator, dtype=torch.float64)
    neighbours = torch.stack([torch.randperm(9, generator=generator)[:5] for _ in range(9)])
    members = torch.cat([values[:, None], values[neighbours]], dim=1)
    torch.testing.assert_close(knn_deviation(values, neighbours), members.std(1).mean())


def test_values_that_are_all_the_same_cost_nothing_and_get_no_gradient():
    values = torch.full((6, 3), 2.0, requires_grad=True)
    loss = knn_deviation(values, torch.arange(6).roll(1)[:, None])
    loss.backward()
    assert loss < 1e-15
    assert torch.equal(values.grad, torch.zeros(6, 3))


@pytest.mark.parametrize(("columns", "near"), [(0, 2), (3, 0)])
def test_without_values_or_neighbours_it_is_nothing(columns, near):
    neighbours = torch.zeros(4, near, dtype=torch.long)
    assert knn_deviation(torch.ones(4, columns), neighbours) < 1e-15


def test_a_shift_of_everything_changes_nothing_and_a_scale_scales():
    values = torch.randn(8, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    neighbours = torch.arange(8).roll(3)[:, None]
    once = knn_deviation(values, neighbours)
    torch.testing.assert_close(knn_deviation(values + 5, neighbours), once)
    torch.testing.assert_close(knn_deviation(3 * values, neighbours), 3 * once)


def test_gradients():
    values = torch.randn(5, 2, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    neighbours = torch.tensor([[1, 2], [0, 2], [3, 4], [1, 4], [0, 1]])
    assert torch.autograd.gradcheck(
        lambda v: knn_deviation(v, neighbours), (values.requires_grad_(),)
    )
