import inspect
import math

import pytest
import torch

from deblur_avatar.avatars import isometry as module
from deblur_avatar.avatars.isometry import isometry, isometry_reference
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from tests.missing_compiler import check_a_warning_without_a_compiler
from tests.process_state import by_threads
from tests.randomness import seeded

pytestmark = pytest.mark.portable

BOTH = pytest.mark.parametrize("dtype", [torch.float32, torch.float64])  # kernel, twin


def others(count, near):
    """So many random others of each point, in no order."""
    return torch.stack(
        [torch.randperm(count - 1, generator=seeded(n))[:near] + 1 + n for n in range(count)]
    ).remainder(count)


def cloud(count=20, dtype=torch.float64):
    points = torch.randn(count, 3, generator=seeded(), dtype=torch.float64)
    return points.to(dtype), others(count, 4)


def covars(count=20, dtype=torch.float64):
    axes = torch.randn(count, 3, 3, generator=seeded(2), dtype=torch.float64)
    rows, columns = torch.triu_indices(3, 3)
    return (axes @ axes.mT)[:, rows, columns].to(dtype)


def pair(count, width, dtype=torch.float32):
    """Values in two poses, with pairs 2 i, 2 i + 1 in one place in one of them, or in both."""
    canonical = torch.randn(count, width, generator=seeded(3), dtype=torch.float64)
    posed = canonical + 0.2 * torch.randn(count, width, generator=seeded(4), dtype=torch.float64)
    for values, step in ((canonical, 4), (posed, 6)):
        twins = values[1::step]
        values[: len(twins) * step : step] = twins
    return [values.to(dtype).requires_grad_() for values in (canonical, posed)]


def with_gradients(function, canonical, posed, near):
    loss = function(canonical, posed, near)
    return [loss.detach(), *torch.autograd.grad(3 * loss, (canonical, posed))]


@pytest.mark.parametrize("width", [1, 3, 5, 6])
@pytest.mark.parametrize(("count", "near"), [(2, 1), (3, 2), (5, 4), (40, 1), (700, 4)])
def test_the_kernel_agrees_with_its_slow_twin_in_value_and_gradient(count, near, width):
    # Those in one place are neighbours.
    index = torch.cat([others(count, near)[:, :-1], torch.arange(count)[:, None] ^ 1], 1)
    index = index.where(index < count, 0)
    native = with_gradients(isometry, *pair(count, width), index)
    exact = with_gradients(isometry_reference, *pair(count, width, torch.float64), index)
    for fast, slow in zip(native, exact, strict=True):
        assert fast.shape == slow.shape
        torch.testing.assert_close(
            fast.double(), slow, rtol=1e-4, atol=1e-5 * slow.abs().max().item()
        )


def test_it_is_the_kernel_that_float32_tensors_go_through(monkeypatch):
    assert module._library() is not None
    monkeypatch.setattr(module, "isometry_reference", None)
    isometry(*pair(20, 3), others(20, 4))


@BOTH
def test_nothing_is_lost_where_nothing_is_wrong(dtype):
    points, near = cloud(dtype=dtype)
    for values in (points, covars(dtype=dtype)):
        here, there = values.clone().requires_grad_(), values.clone().requires_grad_()
        loss, *grads = with_gradients(isometry, here, there, near)
        assert loss == 0
        assert not any(grad.any() for grad in grads)


@BOTH
def test_who_has_no_neighbours_loses_nothing(dtype):
    for count in (0, 1, 3):
        none = torch.empty(count, 0, dtype=torch.int64)
        loss, *grads = with_gradients(isometry, *pair(count, 3, dtype), none)
        assert loss == 0
        assert not any(grad.any() for grad in grads)


@BOTH
def test_a_rigid_motion_of_everything_keeps_all_distances(dtype):
    points, near = cloud(dtype=dtype)
    turn = axis_angle_to_matrix(torch.tensor([0.3, -1.0, 2.0], dtype=dtype))
    moved = points @ turn.T + torch.tensor([1.0, -2, 3], dtype=dtype)
    accuracy = 10 * torch.finfo(dtype).eps
    assert isometry(points, moved, near).item() == pytest.approx(0, abs=accuracy)


@BOTH
def test_growing_by_a_tenth_changes_every_distance_by_a_tenth(dtype):
    points, near = cloud(dtype=dtype)
    spacing = (points[near] - points[:, None]).norm(dim=-1).mean()
    torch.testing.assert_close(isometry(points, 1.1 * points, near), 0.1 * spacing)


@BOTH
def test_distances_of_covariances_count_off_diagonals_once_so_that_a_turn_shows(dtype):
    _, near = cloud()
    canonical = covars(dtype=dtype)
    matrix = torch.zeros(20, 3, 3, dtype=dtype)
    rows, columns = torch.triu_indices(3, 3)
    matrix[:, rows, columns] = canonical
    matrix[:, columns, rows] = canonical
    turn = axis_angle_to_matrix(torch.tensor([0.3, -1.0, 2.0], dtype=dtype))
    turned = (turn @ matrix @ turn.T)[:, rows, columns]
    loss = isometry(canonical, turned, near)
    spacing = (canonical[near] - canonical[:, None]).norm(dim=-1).mean()
    # Not quite invariant, and its docstring says so.
    assert 0.01 * spacing < loss < 0.3 * spacing


def test_the_slow_twin_has_the_gradient_of_differences():
    points, near = cloud(6)
    means = [points.requires_grad_(), (points * 1.3 + 0.1).detach().requires_grad_()]
    shapes = [covars(6).requires_grad_(), (covars(6) * 1.2).requires_grad_()]
    for values in (means, shapes):
        assert torch.autograd.gradcheck(lambda a, b: isometry_reference(a, b, near), values)


@BOTH
def test_gaussians_in_one_place_do_not_pull_at_each_other(dtype):
    points = torch.zeros(4, 3, dtype=dtype, requires_grad=True)
    posed = torch.zeros(4, 3, dtype=dtype, requires_grad=True)
    loss, *grads = with_gradients(isometry, points, posed, torch.tensor([[1], [2], [3], [0]]))
    assert loss == 0
    for grad in grads:
        assert torch.equal(grad, torch.zeros_like(grad))


@BOTH
def test_gaussians_that_part_are_held_back(dtype):
    points = torch.zeros(2, 3, dtype=dtype, requires_grad=True)
    posed = torch.tensor([[0.0, 0, 0], [0, 0.3, 0]], dtype=dtype).requires_grad_()
    loss = isometry(points, posed, torch.tensor([[1], [0]]))
    loss.backward()
    assert loss.item() == pytest.approx(0.3)
    pull = torch.tensor([[0.0, -1, 0], [0, 1, 0]], dtype=dtype)
    torch.testing.assert_close(posed.grad, pull)
    # Neither knows which way apart from the other it should have been.
    assert torch.equal(points.grad, torch.zeros_like(pull))


@pytest.mark.parametrize("width", [3, 6])
def test_only_what_is_asked_for_is_found_and_it_is_the_same(width):
    near = others(50, 4)
    canonical, posed = pair(50, width)
    loss, *both = with_gradients(isometry, canonical, posed, near)
    held = isometry(canonical.detach(), posed, near)
    assert torch.equal(torch.autograd.grad(3 * held, posed)[0], both[1])
    held = isometry(canonical, posed.detach(), near)
    assert torch.equal(torch.autograd.grad(3 * held, canonical)[0], both[0])
    with torch.no_grad():
        assert torch.equal(isometry(canonical, posed, near), loss)


def test_tensors_need_not_be_contiguous():
    near = others(30, 4)
    canonical, posed = pair(30, 3)
    batch = torch.stack([canonical, posed, canonical], 1).detach().requires_grad_()
    wide = torch.cat([near, near], 1)
    loss = isometry(canonical.T.contiguous().T, batch[:, 1], wide[:, :4])
    value, *grads = with_gradients(isometry, canonical, posed, near)
    assert torch.equal(loss, value)
    pulls = torch.autograd.grad(3 * loss, (canonical, batch))
    assert torch.equal(pulls[0], grads[0])
    assert torch.equal(pulls[1][:, 1], grads[1])
    assert not pulls[1][:, ::2].any()


def test_one_pose_out_of_several_can_be_held_to_it():
    canonical, posed = pair(30, 3)
    poses = torch.stack([canonical, posed, canonical]).detach().requires_grad_()
    near = others(30, 4)
    value, *grads = with_gradients(isometry, canonical, posed, near)
    loss = isometry(canonical, poses[1], near)
    assert torch.equal(loss, value)
    assert torch.equal(torch.autograd.grad(3 * loss, poses)[0][1], grads[1])


def test_the_order_of_neighbours_and_of_gaussians_does_not_matter():
    near = others(50, 4)
    canonical, posed = pair(50, 3)
    one = with_gradients(isometry, canonical, posed, near)
    for other, back in (
        (with_gradients(isometry, canonical, posed, near.flip(1)), torch.arange(50)),
        (
            with_gradients(
                isometry,
                canonical.detach().flip(0).requires_grad_(),
                posed.detach().flip(0).requires_grad_(),
                49 - near.flip(0),
            ),
            torch.arange(50).flip(0),
        ),
    ):
        torch.testing.assert_close(other[0], one[0])
        for grad, wanted in zip(other[1:], one[1:], strict=True):
            torch.testing.assert_close(grad[back], wanted)


def test_neither_a_second_time_nor_the_number_of_threads_changes_a_bit():
    def again():
        return with_gradients(isometry, *pair(6000, 6), others(6000, 4))

    results = by_threads(again, 1, 1, 2)
    for values in zip(*results, strict=True):
        assert torch.equal(values[0], values[1])
        assert torch.equal(values[0], values[2])


@BOTH
@pytest.mark.parametrize("width", [3, 5, 6])
@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "too large to be squared"])
def test_what_is_not_finite_is_not_hidden(value, which, width, dtype):
    # The last Gaussian is nobody's neighbour but has some: each way it can be met counts.
    near = torch.tensor([[1, 2], [2, 0], [0, 1], [0, 1]])
    for row in range(4):
        values = pair(4, width, dtype)
        with torch.no_grad():
            values[which][row, -1] = torch.finfo(dtype).max if isinstance(value, str) else value
        assert not torch.isfinite(isometry(*values, near))


@BOTH
def test_two_in_one_place_without_end_are_not_finite_either(dtype):
    values = [torch.full((2, 3), math.inf, dtype=dtype) for _ in range(2)]
    assert not torch.isfinite(isometry(*values, torch.tensor([[1], [0]])))


@BOTH
def test_sizes_that_do_not_fit_are_refused(dtype):
    near = others(5, 2)
    with pytest.raises(ValueError, match=r"got \[5, 3\], \[4, 3\] and \[5, 2\]"):
        inspect.unwrap(isometry)(pair(5, 3, dtype)[0], pair(4, 3, dtype)[0], near)
    with pytest.raises(ValueError, match=r"got \[4, 3\], \[4, 3\] and \[5, 2\]"):
        inspect.unwrap(isometry)(*pair(4, 3, dtype), near)


def test_neighbours_of_another_type_go_to_the_twin(monkeypatch):
    monkeypatch.setattr(module, "isometry_reference", lambda *inputs: inputs)
    values, near = pair(5, 3, torch.float32), others(5, 2).int()
    assert inspect.unwrap(isometry)(*values, near)[2] is near


@BOTH
@pytest.mark.parametrize("wrong", [5, 1 << 40])
def test_a_neighbour_that_there_is_not_is_refused(wrong, dtype):
    near = others(5, 2)
    near[3, 1] = wrong
    with pytest.raises(IndexError):
        isometry(*pair(5, 3, dtype), near)


def test_without_a_compiler_it_is_found_in_plain_torch_and_a_warning_says_why(monkeypatch):
    near = others(50, 4)
    native = with_gradients(isometry, *pair(50, 3), near)
    check_a_warning_without_a_compiler(module, monkeypatch)
    monkeypatch.setattr(module, "_library", lambda: None)
    plain = with_gradients(isometry, *pair(50, 3), near)
    for fast, slow in zip(native, plain, strict=True):
        torch.testing.assert_close(fast, slow)
