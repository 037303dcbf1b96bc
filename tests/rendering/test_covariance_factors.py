import inspect

import pytest
import torch

from deblur_avatar.geometry.rotations import quat_to_matrix
from deblur_avatar.rendering import covariance_factors as module
from deblur_avatar.rendering.covariance_factors import (
    covariance_factors,
    covariance_factors_reference,
    covariances,
    covariances_reference,
)
from tests.gpu_sources import places_of
from tests.missing_compiler import check_a_warning_without_a_compiler
from tests.process_state import by_threads

pytestmark = pytest.mark.portable

place = places_of(module)  # and of its kernel for a GPU
BOTH_PLACES = pytest.mark.usefixtures("place")

COUNT = 500


def scene(count=COUNT, dtype=torch.float32, seed=0):
    generator = torch.Generator().manual_seed(seed)
    quats = torch.randn(count, 4, generator=generator, dtype=dtype)
    quats[: count // 3] = quats.new_tensor([1.0, 0.0, 0.0, 0.0])
    scales = torch.rand(count, 3, generator=generator, dtype=dtype) + 0.01
    turns = torch.randn(count, 3, generator=generator, dtype=dtype)
    turns[: count // 4] = 0
    return [value.requires_grad_() for value in (quats, scales, turns)]


def with_gradients(function, inputs):
    found = function(*inputs)
    weights = torch.linspace(-1, 1, found.numel(), dtype=found.dtype).reshape(found.shape)
    return [found, *torch.autograd.grad((found * weights).sum(), inputs)]


@BOTH_PLACES
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("count", [1, 7, COUNT])
def test_the_kernel_and_its_twin_agree(turned, count):
    inputs = scene(count)[: 3 if turned else 2]
    exact = [value.detach().double().requires_grad_() for value in inputs]
    found = with_gradients(covariance_factors, inputs)
    wanted = with_gradients(covariance_factors_reference, exact)
    for one, other in zip(found, wanted, strict=True):
        torch.testing.assert_close(one.double(), other, rtol=2e-5, atol=2e-5)


@BOTH_PLACES
def test_without_turns_sums_are_in_the_order_of_the_twins():
    inputs = scene()[:2]
    for one, other in zip(
        with_gradients(covariance_factors, inputs),
        with_gradients(covariance_factors_reference, inputs),
        strict=True,
    ):
        # Bits are the processor's (torch's twin fuses products on some); where a sum cancels,
        # another order stands out by far more than these five units of the last place.
        torch.testing.assert_close(one, other, rtol=6e-7, atol=0)


@BOTH_PLACES
def test_covariances_are_upper_triangles_of_covariance_factors_times_their_transpose():
    whole = covariance_factors_reference(*scene()).detach()
    rows, columns = torch.triu_indices(3, 3)
    for function in (covariances, covariances_reference):
        found = function(whole)
        torch.testing.assert_close(found, (whole @ whole.mT)[:, rows, columns])


@BOTH_PLACES
def test_covariances_have_the_gradients_of_their_twin():
    inputs = [covariance_factors_reference(*scene()).detach().requires_grad_()]
    for one, other in zip(
        with_gradients(covariances, inputs),
        with_gradients(covariances_reference, inputs),
        strict=True,
    ):
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-6)


@BOTH_PLACES
def test_a_turn_comes_after_the_gaussians_own_rotation():
    quats, scales, turns = scene()
    after = torch.nn.functional.pad(turns, (1, 0), value=1.0)
    wanted = quat_to_matrix(after) @ quat_to_matrix(quats) * scales[:, None, :]
    torch.testing.assert_close(
        covariance_factors(quats, scales, turns), wanted, rtol=1e-4, atol=1e-5
    )
    torch.testing.assert_close(
        covariance_factors(quats, scales, 0 * turns),
        covariance_factors(quats, scales),
        rtol=0,
        atol=0,
    )


def test_the_length_of_a_quaternion_says_nothing():
    quats, scales, turns = scene()
    torch.testing.assert_close(
        covariance_factors(3 * quats, scales, turns), covariance_factors(quats, scales, turns)
    )
    (gradient,) = torch.autograd.grad(covariance_factors(quats, scales).sum(), [quats])
    along = (gradient * quats).sum(1) / quats.norm(dim=1)
    assert along.abs().max() < 1e-4


@pytest.mark.parametrize("turned", [False, True])
def test_the_twin_has_the_gradients_of_differences(turned):
    inputs = scene(5, torch.float64)[: 3 if turned else 2]
    assert torch.autograd.gradcheck(covariance_factors_reference, inputs)


@BOTH_PLACES
def test_strided_inputs_are_taken_as_they_are_meant():
    quats, scales, turns = scene()
    apart = [torch.stack([v, -v], dim=1)[:, 0] for v in (quats, scales)]
    change = torch.cat([turns, turns, turns], dim=1)[:, 3:6]
    assert not change.is_contiguous()
    for one, other in zip(
        with_gradients(covariance_factors, [*apart, change]),
        with_gradients(covariance_factors, [quats, scales, turns]),
        strict=True,
    ):
        assert torch.equal(one, other)


def test_what_the_kernel_does_not_read_goes_to_its_twin_or_is_refused():
    quats, scales, turns = (value.detach() for value in scene(9))
    exact = covariance_factors_reference(quats, scales.double(), turns)
    assert torch.equal(covariance_factors(quats, scales.double(), turns), exact)
    for wrong in ((quats, scales[:1]), (quats[:, :3], scales), (quats, scales, turns[:, :2])):
        with pytest.raises(ValueError, match="must be"):
            inspect.unwrap(covariance_factors)(*wrong)


@pytest.mark.parametrize("odd", [torch.nan, torch.inf])
@pytest.mark.parametrize("which", [0, 1, 2])
def test_what_is_not_finite_is_not_hidden(odd, which):
    inputs = [value.detach().clone() for value in scene()]
    inputs[which][3, 1] = odd
    found, *gradients = with_gradients(
        covariance_factors, [value.requires_grad_() for value in inputs]
    )
    assert not torch.isfinite(found[3]).all()
    assert not all(bool(torch.isfinite(value[3]).all()) for value in gradients)
    assert all(bool(torch.isfinite(value[4:]).all()) for value in (found, *gradients))


def test_it_is_the_kernel_that_float32_tensors_go_through(monkeypatch):
    assert module._library() is not None
    monkeypatch.setattr(module, "covariance_factors_reference", None)
    monkeypatch.setattr(module, "covariances_reference", None)
    covariances(covariance_factors(*scene()))


def test_without_a_compiler_there_is_the_twin_and_a_warning_says_why(monkeypatch):
    check_a_warning_without_a_compiler(module, monkeypatch)
    monkeypatch.setattr(module, "_library", lambda: None)
    inputs = scene()
    assert torch.equal(covariance_factors(*inputs), covariance_factors_reference(*inputs))


def test_the_number_of_threads_changes_no_bit():
    def both():
        return with_gradients(lambda *inputs: covariances(covariance_factors(*inputs)), scene(3000))

    results = by_threads(both, 1, 2)
    for one, two in zip(*results, strict=True):
        assert torch.equal(one, two)
