import dataclasses
import math
from types import SimpleNamespace

import pytest
import torch

from deblur_avatar.training import objective
from deblur_avatar.training import picture_losses as module
from deblur_avatar.training.losses import LOSSES, coverage, photometric, structure
from deblur_avatar.training.objective import Objective
from deblur_avatar.training.picture_losses import has_kernel, picture_losses
from deblur_avatar.training.supervision import Compared
from deblur_avatar.training.targets import Target
from tests.gpu_sources import places_of
from tests.missing_compiler import check_a_warning_without_a_compiler
from tests.process_state import by_threads
from tests.randomness import seeded

pytestmark = pytest.mark.portable

place = places_of(module)  # and of its kernel for a GPU
BOTH_PLACES = pytest.mark.usefixtures("place")

WEIGHTS = {"l1": 1.0, "structure": 0.3, "mask": 0.2}
BOX = (3, 2, 36, 45)  # odd sides and odd halves
WHOLE = (0, 0, 40, 50)


def render(height=50, width=40, seed=0):
    """A picture with values beyond black and white, in which light lies in [0.004, 1]."""
    image = torch.rand(height, width, 3, generator=seeded(seed)) * 1.2 - 0.1
    image = torch.where(image.abs() < 0.004, 0.004, image)
    return image, torch.rand(height, width, generator=seeded(seed + 1))


def target(box=BOX, comparable=False, height=50, width=40, weight=0.7, background=False):
    image, matte = render(height, width, seed=5)
    part = (torch.rand(height, width, generator=seeded(9)) * 1.5).clamp(max=1)
    part[: height // 3] = 0
    image = image.clamp(0, 1) * (part[..., None] if comparable else 1)
    behind = render(height, width, seed=11)[0] if background else None
    return Target(image, matte, part if comparable else None, box, weight, behind)


def terms_and_gradients(seen, space="srgb", weights=WEIGHTS, dtype=torch.float32, picture=None):
    """Of a step's objective, whose table of losses is the slow twin."""
    image, alpha = [v.to(dtype).requires_grad_() for v in picture or render(*seen.matte.shape)]
    tensors = {
        name: value.to(dtype)
        for name in ("image", "matte", "comparable", "background")
        if (value := getattr(seen, name)) is not None
    }
    asked = object.__new__(Objective)
    asked._avatar = SimpleNamespace(averaging_space=space)
    asked._weights = weights
    on = {name: LOSSES[name].on(torch.device("cpu")) for name in weights}
    asked._losses = {name: (LOSSES[name], on[name]) for name in weights}
    shown = [Compared(1.0, image, alpha)]
    terms = asked.pictures(shown, alpha, dataclasses.replace(seen, **tensors))
    total = torch.stack(list(terms.values())).sum()
    grads = torch.autograd.grad(total, (image, alpha), allow_unused=True, materialize_grads=True)
    return {name: term.detach() for name, term in terms.items()}, grads


def check_agreement(seen, **options):
    terms, grads = terms_and_gradients(seen, **options)
    exact, wanted = terms_and_gradients(seen, dtype=torch.float64, **options)
    assert list(terms) == list(exact)
    for name, term in terms.items():
        assert term.shape == ()
        torch.testing.assert_close(term.double(), exact[name], rtol=1e-6, atol=1e-9)
    for grad, own in zip(grads, wanted, strict=True):
        # Of the largest: where differences of many pixels meet, they all but cancel.
        size = max(own.abs().max().item(), 1e-30)
        torch.testing.assert_close(grad.double(), own, rtol=1e-6, atol=1e-6 * size)


@BOTH_PLACES
@pytest.mark.parametrize("space", ["srgb", "linear"])
@pytest.mark.parametrize("comparable", [False, True])
@pytest.mark.parametrize("box", [BOX, WHOLE, (8, 4, 24, 36)])
def test_the_kernel_agrees_with_the_table_of_losses_in_value_and_gradient(space, comparable, box):
    check_agreement(target(box, comparable), space=space)


@BOTH_PLACES
@pytest.mark.parametrize("space", ["srgb", "linear"])
def test_coverage_learns_from_the_background_that_it_hides(space):
    check_agreement(target(comparable=True, background=True), space=space)
    shown, hidden = (
        terms_and_gradients(target(background=known), space=space, weights={"l1": 1.0})[1][1]
        for known in (True, False)
    )
    assert shown.abs().max() > 0
    assert hidden.abs().max() == 0


@BOTH_PLACES
@pytest.mark.parametrize(
    "names",
    [
        ("l1",),
        ("structure",),
        ("mask",),
        ("l1", "mask"),
        ("structure", "mask"),
        ("l1", "structure"),
    ],
)
def test_any_of_the_losses_may_be_without_weight(names):
    check_agreement(target(), weights={name: WEIGHTS[name] for name in names})


@BOTH_PLACES
@pytest.mark.parametrize("sides", [(0, 0), (0, 5), (1, 1), (1, 8), (2, 1), (2, 2), (3, 2), (5, 4)])
@pytest.mark.parametrize("names", [("l1", "structure"), ("structure", "mask")])
def test_small_boxes_have_as_many_scales_as_fit(sides, names):
    height, width = sides
    box = (4, 3, 4 + width, 3 + height)
    check_agreement(target(box), weights={name: WEIGHTS[name] for name in names})


@BOTH_PLACES
def test_a_picture_may_be_one_pixel():
    check_agreement(target((0, 0, 1, 1), height=1, width=1))


@BOTH_PLACES
def test_other_losses_are_found_beside_it_and_terms_keep_the_tables_order():
    weights = {"l1": 1.0, "structure": 0.1, "dissimilarity": 0.4, "mask": 0.2}
    terms, grads = terms_and_gradients(target(), weights=weights)
    exact, wanted = terms_and_gradients(target(), dtype=torch.float64, weights=weights)
    assert list(terms) == list(exact) == list(weights)
    for name, term in terms.items():
        torch.testing.assert_close(term.double(), exact[name], rtol=1e-5, atol=0)
    torch.testing.assert_close(grads[0].double(), wanted[0], rtol=1e-3, atol=1e-7)


@BOTH_PLACES
@pytest.mark.parametrize("space", ["srgb", "linear"])
def test_light_of_any_strength_is_encoded_as_the_standard_says(space):
    light = torch.logspace(-6, 0, 3000)[:, None, None].expand(-1, 1, 3).contiguous()
    light[light < 0.004] *= 0.5  # none so near the knee that rounding decides its piece
    black = torch.zeros(3000, 1)
    seen = Target(torch.zeros(3000, 1, 3), black, None, (0, 0, 1, 3000), 1.0)
    check_agreement(seen, space=space, weights={"l1": 1.0}, picture=(light, black))


@BOTH_PLACES
def test_what_is_the_same_pulls_at_nothing_at_any_scale():
    # Thirds are not exact: a mean of four of them, of two and of one must yet be the same.
    seen = target((1, 1, 20, 22), height=23, width=21)
    flat = torch.full_like(seen.image, 1 / 3)
    seen = dataclasses.replace(seen, image=flat, matte=flat[..., 0])
    for level in (1 / 3, 0.6):
        picture = torch.full_like(flat, level), flat[..., 0]
        terms, grads = terms_and_gradients(seen, picture=picture)
        assert terms["structure"] == 0
        assert terms["mask"] == 0
        assert torch.equal(grads[0], torch.full_like(flat, 0.7 / flat.numel() * (level > 0.5)))
        assert not grads[1].any()


@BOTH_PLACES
def test_a_render_that_is_the_frame_where_that_is_comparable_pulls_at_nothing():
    image, alpha = render()
    image.clamp_(0, 1)
    part = torch.rand(alpha.shape, generator=seeded(2))
    seen = Target(image * part[..., None], alpha, part, BOX, 1.0)
    terms, grads = terms_and_gradients(seen, picture=(image, alpha))
    assert not any(terms.values())
    assert not any(grad.any() for grad in grads)


@BOTH_PLACES
def test_black_and_white_themselves_still_pull_but_not_what_lies_beyond():
    image = torch.tensor([[[0.0, -0.1, 1.0]], [[1.1, 0.5, math.inf]]])
    seen = Target(torch.full((2, 1, 3), 0.4), torch.zeros(2, 1), None, (0, 0, 1, 2), 1.0)
    _, grads = terms_and_gradients(seen, weights={"l1": 6.0}, picture=(image, torch.zeros(2, 1)))
    assert torch.equal(grads[0], torch.tensor([[[-1.0, 0, 1]], [[0, 1, 0]]]))


@BOTH_PLACES
def test_it_is_the_kernel_that_float32_pictures_go_through(monkeypatch):
    assert module._library() is not None
    monkeypatch.setattr(objective, "encode", None)
    terms_and_gradients(target())


def test_several_pictures_or_shares_of_them_are_compared_in_plain_torch(monkeypatch):
    monkeypatch.setattr(objective, "picture_losses", None)
    seen, (image, alpha) = target(), render()
    asked = object.__new__(Objective)
    asked._avatar = SimpleNamespace(averaging_space="srgb")
    asked._weights, asked._losses = WEIGHTS, {"l1": (LOSSES["l1"], photometric)}
    one = asked.pictures([Compared(0.5, image, alpha)], alpha, seen)["l1"]
    torch.testing.assert_close(
        asked.pictures([Compared(0.5, image, alpha)] * 2, alpha, seen)["l1"], 2 * one
    )


def test_a_row_that_compares_otherwise_is_not_the_kernels(monkeypatch):
    monkeypatch.setitem(LOSSES, "l1", dataclasses.replace(LOSSES["l1"], region="box"))
    check_agreement(target())


@pytest.mark.parametrize("weights", [WEIGHTS, {"structure": 1.0}])
def test_the_number_of_threads_changes_no_bit(weights):
    seen = target(comparable=True)
    results = by_threads(lambda: terms_and_gradients(seen, "linear", weights), 1, 2, 7)
    for terms, grads in results[1:]:
        assert all(torch.equal(terms[name], results[0][0][name]) for name in weights)
        assert all(torch.equal(*pair) for pair in zip(grads, results[0][1], strict=True))


@BOTH_PLACES
def test_each_loss_has_a_gradient_of_its_own():
    inputs = [value.requires_grad_() for value in render()]
    weights = {photometric: 1.0, structure: 0.3, coverage: 0.2}
    losses = list(picture_losses(*inputs, target(), "srgb", weights).values())
    l1, edges, mask = [torch.autograd.grad(loss, inputs, retain_graph=True) for loss in losses]
    grads = torch.autograd.grad(2 * losses[0] - 3 * losses[1] + 5 * losses[2], inputs)
    torch.testing.assert_close(grads[0], 2 * l1[0] - 3 * edges[0], rtol=1e-5, atol=1e-9)
    torch.testing.assert_close(grads[1], 5 * mask[1])
    assert not any(grad.any() for grad in (l1[1], edges[1], mask[0]))


@BOTH_PLACES
def test_tensors_need_not_be_contiguous():
    seen, (image, alpha) = target(comparable=True, background=True), render()
    straight = terms_and_gradients(seen, picture=(image, alpha))
    tensors = {
        name: getattr(seen, name).transpose(0, 1).contiguous().transpose(0, 1)
        for name in ("image", "matte", "comparable", "background")
    }
    strided = terms_and_gradients(
        dataclasses.replace(seen, **tensors),
        picture=[v.transpose(0, 1).contiguous().transpose(0, 1) for v in (image, alpha)],
    )
    assert straight[0] == strided[0]
    assert all(torch.equal(*pair) for pair in zip(straight[1], strided[1], strict=True))


@BOTH_PLACES
@pytest.mark.parametrize("space", ["srgb", "linear"])
def test_what_is_not_a_number_is_not_hidden(space):
    for place, names in (((7, 8, 1), ("l1", "structure")), ((0, 0, 0), ("l1",))):
        image, alpha = render()
        image[place] = math.nan
        terms, _ = terms_and_gradients(target(), space, picture=(image, alpha))
        assert all(torch.isnan(terms[name]) for name in names)
        assert torch.isfinite(terms["mask"])
    image, alpha = render()
    alpha[3, 3] = math.nan
    assert torch.isnan(terms_and_gradients(target(), space, picture=(image, alpha))[0]["mask"])


@BOTH_PLACES
def test_what_it_does_not_look_at_may_be_anything():
    image, alpha = render()
    image[0, 0, 0] = math.nan
    terms, _ = terms_and_gradients(
        target(), weights={"structure": 1.0}, picture=(image, alpha * math.nan)
    )
    assert torch.isfinite(terms["structure"])


@BOTH_PLACES
def test_doubles_are_not_the_kernels():
    image, alpha = render()
    assert has_kernel(image, alpha)
    assert not has_kernel(image.double(), alpha)
    assert not has_kernel(image, alpha.double())


def test_without_a_compiler_the_table_is_walked_and_a_warning_says_why(monkeypatch):
    native = terms_and_gradients(target())
    check_a_warning_without_a_compiler(module, monkeypatch)
    monkeypatch.setattr(module, "_library", lambda: None)
    plain = terms_and_gradients(target())
    for name, term in native[0].items():
        torch.testing.assert_close(term, plain[0][name])
    for fast, slow in zip(native[1], plain[1], strict=True):
        torch.testing.assert_close(fast, slow, rtol=1e-5, atol=1e-9)
