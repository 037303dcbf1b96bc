import inspect
import math

import pytest
import torch

from deblur_avatar.avatars import knn_smoothness as module
from deblur_avatar.avatars.gaussians import neighbour_indices
from deblur_avatar.avatars.knn_smoothness import knn_smoothness, knn_smoothness_reference
from tests.gpu_sources import places_of, taken_for_a_gpu
from tests.missing_compiler import check_a_warning_without_a_compiler
from tests.process_state import by_threads
from tests.randomness import seeded

pytestmark = pytest.mark.portable

place = places_of(module)  # and of its kernel for a GPU
BOTH_PLACES = pytest.mark.usefixtures("place")

BOTH = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])  # kernel, twin


def drawn(count, width, near, dtype=torch.float32):
    """Values, some of them alike, and so many random others of each Gaussian."""
    values = torch.randn(count, width, generator=seeded(count), dtype=torch.float64)
    values[1::5] = values[:1]
    others = torch.randint(1, max(count, 2), (count, near), generator=seeded(1))
    neighbours = (others + torch.arange(count)[:, None]).remainder(count)
    return values.to(dtype).requires_grad_(), neighbours


def with_gradient(function, values, neighbours):
    loss = function(values, neighbours)
    return [loss.detach(), *torch.autograd.grad(3 * loss, values)]


@BOTH_PLACES
@pytest.mark.parametrize("width", [1, 3, 4, 6])
@pytest.mark.parametrize(("count", "near"), [(1, 1), (2, 1), (5, 4), (40, 1), (9000, 4)])
def test_the_kernel_agrees_with_its_slow_twin_in_value_and_gradient(count, near, width):
    native = with_gradient(knn_smoothness, *drawn(count, width, near))
    exact = with_gradient(knn_smoothness_reference, *drawn(count, width, near, torch.float64))
    for fast, slow in zip(native, exact, strict=True):
        assert fast.shape == slow.shape
        # The twin's signs do not quite cancel, the kernel's do.
        torch.testing.assert_close(fast.double(), slow, rtol=1e-6, atol=1e-18)


def test_it_is_the_kernel_that_float32_values_go_through(monkeypatch):
    assert module._library() is not None
    monkeypatch.setattr(module, "knn_smoothness_reference", None)
    knn_smoothness(*drawn(20, 3, 4))


@BOTH_PLACES
@BOTH
def test_what_is_the_same_everywhere_is_even_and_an_edge_costs_no_more_than_a_slope(dtype):
    row = torch.arange(10)
    near = torch.stack([(row - 1).clamp(min=0), (row + 1).clamp(max=9)], 1)
    flat = torch.full((10, 1), 3.0, dtype=dtype)
    slope = torch.linspace(0, 1, 10, dtype=dtype)[:, None]
    edge = (row > 4).to(dtype)[:, None]
    assert knn_smoothness(flat, near) == 0
    # Ten differences of a ninth, or one of 1, each met from both sides, among 20.
    assert knn_smoothness(slope, near).item() == pytest.approx(2 / 20)
    assert knn_smoothness(edge, near).item() == pytest.approx(2 / 20)


@BOTH_PLACES
@BOTH
def test_a_gaussian_and_its_neighbour_are_drawn_to_each_other_alike(dtype):
    values = torch.tensor([[0.0, 2], [1, 2]], dtype=dtype, requires_grad=True)
    _, pull = with_gradient(knn_smoothness, values, torch.tensor([[1], [1]]))
    # The second is its own neighbour, and no different from itself.
    assert torch.equal(pull, torch.tensor([[-0.75, 0], [0.75, 0]], dtype=dtype))


@BOTH_PLACES
@BOTH
def test_a_gaussian_without_neighbours_is_smooth(dtype):
    alone = neighbour_indices(torch.zeros(1, 3), 4)
    for count, none in ((1, alone), (0, alone[:0]), (3, alone.expand(3, 0))):
        loss, grad = with_gradient(knn_smoothness, drawn(count, 3, 1, dtype)[0], none)
        assert loss == 0
        assert not grad.any()


def test_the_slow_twin_has_the_gradient_of_differences():
    values = torch.randn(20, 3, generator=seeded(), dtype=torch.float64, requires_grad=True)
    _, neighbours = drawn(20, 3, 4)
    assert torch.autograd.gradcheck(lambda v: knn_smoothness_reference(v, neighbours), values)


def test_neither_the_order_of_neighbours_nor_the_number_of_threads_changes_a_gradients_bit():
    values, neighbours = drawn(20000, 4, 4)
    results = by_threads(lambda: with_gradient(knn_smoothness, values, neighbours), 1, 2, 5)
    for loss, grad in results[1:]:
        assert torch.equal(loss, results[0][0])
        assert torch.equal(grad, results[0][1])
    _, grad = with_gradient(knn_smoothness, values, neighbours.flip(1))
    assert torch.equal(grad, results[0][1])


def test_without_gradient_the_value_is_the_same():
    values, neighbours = drawn(50, 4, 4)
    assert torch.equal(
        knn_smoothness(values.detach(), neighbours), knn_smoothness(values, neighbours)
    )


def test_tensors_need_not_be_contiguous():
    values, neighbours = drawn(30, 4, 4)
    wide = torch.cat([values, values], 1).detach().requires_grad_()
    loss, grad = with_gradient(knn_smoothness, values, neighbours)
    strided = knn_smoothness(wide[:, :4], neighbours.T.contiguous().T)
    assert torch.equal(strided, loss)
    (pull,) = torch.autograd.grad(3 * strided, wide)
    assert torch.equal(pull[:, :4], grad)


@BOTH
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_not_hidden(value, dtype):
    neighbours = torch.tensor([[1, 2], [2, 0], [0, 1], [0, 1]])
    for row in range(4):  # the last is nobody's neighbour
        values = torch.zeros(4, 3, dtype=dtype)
        values[row, -1] = value
        assert not torch.isfinite(knn_smoothness(values, neighbours))


@BOTH
def test_sizes_that_do_not_fit_are_refused(dtype):
    values, neighbours = drawn(5, 3, 2, dtype)
    with pytest.raises(ValueError, match=r"got \[4, 3\] and \[5, 2\]"):
        inspect.unwrap(knn_smoothness)(values[:4], neighbours)


@BOTH
@pytest.mark.parametrize("wrong", [5, -1, 1 << 40])
def test_a_neighbour_that_there_is_not_is_refused(wrong, dtype):
    values, neighbours = drawn(5, 3, 2, dtype)
    neighbours[3, 1] = wrong
    with pytest.raises((IndexError, RuntimeError), match="neighbours must be|out of"):
        knn_smoothness(values, neighbours)


@pytest.mark.parametrize("wrong", [5, -1, 1 << 40])
def test_on_a_gpu_a_neighbour_that_there_is_not_makes_the_loss_not_a_number(wrong):
    values, neighbours = drawn(5, 3, 2)
    neighbours[3, 1] = wrong
    with taken_for_a_gpu(module):
        assert torch.isnan(knn_smoothness(values, neighbours))


def test_neighbours_of_another_type_go_to_the_twin(monkeypatch):
    monkeypatch.setattr(module, "knn_smoothness_reference", lambda *inputs: inputs)
    values, neighbours = drawn(5, 3, 2)
    assert inspect.unwrap(knn_smoothness)(values, neighbours.int())[1].dtype == torch.int32


def test_without_a_compiler_it_is_found_in_plain_torch_and_a_warning_says_why(monkeypatch):
    native = with_gradient(knn_smoothness, *drawn(50, 3, 4))
    check_a_warning_without_a_compiler(module, monkeypatch)
    monkeypatch.setattr(module, "_library", lambda: None)
    plain = with_gradient(knn_smoothness, *drawn(50, 3, 4))
    for fast, slow in zip(native, plain, strict=True):
        torch.testing.assert_close(fast, slow)
