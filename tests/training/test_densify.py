import pytest
import torch

from deblur_avatar.avatars.gaussians import Gaussians
from deblur_avatar.avatars.params import DensifyParams
from deblur_avatar.training.densify import Densifier, replace_gaussians
from tests.randomness import seeded

CPU = torch.device("cpu")
SMALL, LARGE, HUGE = 0.01, 0.1, 1.0  # metres
PARAMS = DensifyParams(
    start=1, stop=100, every=10, gradient=1e-3, clone_below_m=0.03, prune_opacity=0.05,
    prune_scale_m=0.5, max_growth=2.0,
)  # fmt: skip


def gaussians_of(scales, opacities=None):
    count = len(scales)
    opacities = [0.5] * count if opacities is None else opacities
    return Gaussians(
        means=torch.arange(count)[:, None] * torch.ones(3) * 10,
        quats=torch.randn(count, 4, generator=seeded()),
        log_scales=torch.tensor(scales).log()[:, None].repeat(1, 3),
        opacity_logits=torch.tensor(opacities).logit(),
        features=torch.arange(2.0 * count).reshape(count, 2),
    )


def optimizer_of(gaussians, steps=1):
    groups = [{"params": [p], "names": [name]} for name, p in gaussians.named_parameters()]
    optimizer = torch.optim.Adam(groups, lr=0.0)
    for _ in range(steps):
        for parameter in gaussians.parameters():
            row = torch.arange(1.0, len(parameter) + 1)
            parameter.grad = row.reshape(-1, *[1] * (parameter.ndim - 1)).expand_as(parameter)
        optimizer.step()
    optimizer.zero_grad()
    return optimizer


def pulled(gaussians, strengths, width=2, height=2):
    """A densifier that has seen Gaussians pulled so strongly, in half image widths."""
    densifier = Densifier(len(gaussians), CPU)
    gradients = torch.zeros(1, len(gaussians), 2)
    gradients[0, :, 0] = torch.tensor(strengths)
    densifier.observe(gradients, torch.ones(1, len(gaussians), dtype=torch.int32), width, height)
    return densifier


def edited(scales, strengths, opacities=None, params=PARAMS):
    gaussians = gaussians_of(scales, opacities)
    optimizer = optimizer_of(gaussians)
    pulled(gaussians, strengths).edit(gaussians, optimizer, params, seeded())
    return gaussians, optimizer


def test_what_is_not_pulled_stays_as_it_is():
    gaussians, _ = edited([SMALL, LARGE, SMALL], [0.0, 0.9e-3, 0.0])
    before = gaussians_of([SMALL, LARGE, SMALL])
    for (name, value), (_, old) in zip(
        gaussians.named_parameters(), before.named_parameters(), strict=True
    ):
        assert torch.equal(value, old), name


def test_a_small_gaussian_that_is_pulled_is_cloned():
    gaussians, _ = edited([SMALL, SMALL, SMALL], [0.0, 2e-3, 0.0])
    before = gaussians_of([SMALL, SMALL, SMALL])
    for (name, value), (_, old) in zip(
        gaussians.named_parameters(), before.named_parameters(), strict=True
    ):
        assert torch.equal(value, old[[0, 1, 2, 1]]), name


def test_a_large_gaussian_that_is_pulled_gives_way_to_two_narrower_ones_within_it():
    gaussians, _ = edited([SMALL, LARGE], [0.0, 2e-3])
    before = gaussians_of([SMALL, LARGE])
    assert len(gaussians) == 3
    assert torch.equal(gaussians.means[0], before.means[0])
    halves = slice(1, 3)
    torch.testing.assert_close(gaussians.scales[halves], torch.full((2, 3), LARGE / 1.6))
    offsets = gaussians.means[halves] - before.means[1]
    assert (offsets.norm(dim=1) < 4 * LARGE).all()
    assert (offsets[0] - offsets[1]).norm() > 0.01 * LARGE
    for name in ("quats", "opacity_logits", "features"):
        value, old = getattr(gaussians, name), getattr(before, name)
        assert torch.equal(value[halves], old[[1, 1]])


def test_halves_are_spread_as_the_gaussian_was():
    count = 2000
    gaussians = Gaussians(
        means=torch.zeros(count, 3),
        # A quarter turn about z: the first axis points along y.
        quats=torch.tensor([0.5**0.5, 0, 0, 0.5**0.5]).repeat(count, 1),
        log_scales=torch.tensor([0.4, 0.2, 0.1]).log().repeat(count, 1),
        opacity_logits=torch.zeros(count),
        features=torch.zeros(count, 1),
    )
    params = PARAMS.model_copy(update={"max_growth": 3.0})
    pulled(gaussians, [1.0] * count).edit(gaussians, optimizer_of(gaussians), params, seeded())
    assert len(gaussians) == 2 * count
    torch.testing.assert_close(
        gaussians.means.std(0), torch.tensor([0.2, 0.4, 0.1]), rtol=0.05, atol=0
    )


def test_faint_and_huge_gaussians_are_dropped():
    gaussians, _ = edited([SMALL, SMALL, HUGE, SMALL], [0.0] * 4, opacities=[0.5, 0.04, 0.5, 0.06])
    assert gaussians.features[:, 0].tolist() == [0.0, 6.0]


def test_growth_ends_at_the_cap_and_the_strongest_come_first():
    params = PARAMS.model_copy(update={"max_growth": 1.5})
    gaussians, _ = edited([SMALL] * 4, [2e-3, 5e-3, 3e-3, 4e-3], params=params)
    assert len(gaussians) == 6
    assert sorted(gaussians.features[4:, 0].tolist()) == [2.0, 6.0]


def test_at_the_cap_nothing_is_added():
    params = PARAMS.model_copy(update={"max_growth": 1.0})
    gaussians, _ = edited([SMALL, LARGE], [1.0, 1.0], params=params)
    assert len(gaussians) == 2
    assert torch.equal(gaussians.means, gaussians_of([SMALL, LARGE]).means)


def test_survivors_keep_the_optimizers_memory_and_newcomers_have_none():
    gaussians, optimizer = edited(
        [SMALL, SMALL, LARGE, SMALL], [0.0, 2e-3, 2e-3, 0.0], opacities=[0.5, 0.5, 0.5, 0.01]
    )
    assert len(gaussians) == 2 + 1 + 2  # two survivors, a clone, two halves
    assert len(optimizer.state) == 5
    for group in optimizer.param_groups:
        (parameter,) = group["params"]
        assert parameter is getattr(gaussians, group["names"][0])
        memory = optimizer.state[parameter]
        assert memory["step"] == 1
        row = 0.1 * torch.tensor([1.0, 2, 0, 0, 0])  # (1 - beta1) of the first gradient
        expected = row.reshape(-1, *[1] * (parameter.ndim - 1)).expand_as(parameter)
        torch.testing.assert_close(memory["exp_avg"], expected)
        assert (memory["exp_avg_sq"][:2] > 0).all()
        assert memory["exp_avg_sq"][2:].abs().max() == 0


def test_an_optimizer_without_memory_stays_without():
    gaussians = gaussians_of([SMALL, SMALL])
    optimizer = optimizer_of(gaussians, steps=0)
    keep = torch.tensor([True, False])
    replace_gaussians(gaussians, optimizer, keep, [])
    assert len(gaussians) == 1
    gaussians.means.grad = torch.ones(1, 3)
    optimizer.step()
    assert optimizer.state[gaussians.means]["step"] == 1


def test_pulls_are_measured_in_half_image_widths_so_that_resolution_does_not_matter():
    coarse = pulled(gaussians_of([SMALL]), [4e-3], width=10, height=10).state()["pull"]
    fine = pulled(gaussians_of([SMALL]), [2e-3], width=20, height=20).state()["pull"]
    torch.testing.assert_close(coarse, fine)
    torch.testing.assert_close(coarse, torch.tensor([4e-3 * 5]))


def test_opposite_instants_do_not_cancel_and_a_frame_is_one_visit():
    densifier = Densifier(2, CPU)
    gradients = torch.tensor([[[3e-3, 4e-3], [0, 0]], [[-3e-3, -4e-3], [0, 0]]])
    densifier.observe(gradients, torch.tensor([[1, 1], [0, 0]], dtype=torch.int32), 2, 2)
    torch.testing.assert_close(densifier.state()["pull"], torch.tensor([1e-2, 0.0]))
    assert densifier.state()["visits"].tolist() == [1, 1]


def test_a_still_body_is_pulled_alike_whether_its_exposure_is_one_instant_or_five():
    gradient = torch.rand(1, 3, 2, generator=seeded())
    radii = torch.ones(5, 3, dtype=torch.int32)
    one, five = Densifier(3, CPU), Densifier(3, CPU)
    one.observe(gradient, radii[:1], 20, 30)
    five.observe(gradient.expand(5, 3, 2) / 5, radii, 20, 30)
    torch.testing.assert_close(one.state()["pull"], five.state()["pull"])
    assert torch.equal(one.state()["visits"], five.state()["visits"])


def test_what_decides_is_the_mean_over_the_frames_that_show_a_gaussian():
    gaussians = gaussians_of([SMALL, SMALL])
    densifier = Densifier(2, CPU)
    for shown in (True, True, False):  # 1.2e-3 in two of three frames: seen twice, or always
        gradients = torch.full((1, 2, 2), 0.0)
        gradients[0, :, 0] = 1.2e-3 * shown
        radii = torch.tensor([[int(shown), 1]], dtype=torch.int32)
        densifier.observe(gradients, radii, 2, 2)
    densifier.edit(gaussians, optimizer_of(gaussians), PARAMS, seeded())
    assert gaussians.features[:, 0].tolist() == [0.0, 2.0, 0.0]


def test_editing_starts_a_new_count():
    gaussians = gaussians_of([SMALL, SMALL])
    densifier = pulled(gaussians, [2e-3, 0.0])
    densifier.edit(gaussians, optimizer_of(gaussians), PARAMS, seeded())
    state = densifier.state()
    assert state["pull"].tolist() == [0, 0, 0]
    assert state["visits"].tolist() == [0, 0, 0]


@pytest.mark.parametrize("most", [1.0, 2.0])
def test_a_restored_densifier_decides_as_the_saved_one_would(most):
    params = PARAMS.model_copy(update={"max_growth": most})
    strengths = [2e-3, 0.0, 3e-3]
    saved = pulled(gaussians_of([SMALL] * 3), strengths)
    restored = Densifier(17, CPU)
    restored.restore(saved.state())
    results = []
    for densifier in (saved, restored):
        gaussians = gaussians_of([SMALL] * 3)
        densifier.edit(gaussians, optimizer_of(gaussians), params, seeded())
        results.append(gaussians.features.tolist())
    assert results[0] == results[1]
    assert len(results[0]) == (5 if most == 2.0 else 3)


def test_an_avatars_own_rule_takes_the_place_of_the_usual_one():
    gaussians = gaussians_of([SMALL, SMALL, HUGE])
    optimizer, asked = optimizer_of(gaussians), []

    def rule(pulls, params, room, generator):
        asked.append((pulls, params, room))
        keep = torch.tensor([True, False, True])
        return keep, [{name: value.data[:1] for name, value in gaussians.named_parameters()}]

    densifier = pulled(gaussians, [2e-3, 0.0, 0.0])
    densifier.edit(gaussians, optimizer, PARAMS, seeded(), rule)
    assert gaussians.features[:, 0].tolist() == [0.0, 4.0, 0.0]
    ((pulls, params, room),) = asked
    torch.testing.assert_close(pulls, torch.tensor([2e-3, 0.0, 0.0]))
    assert params is PARAMS
    assert room == 3
    assert densifier.state()["pull"].tolist() == [0, 0, 0]


def test_a_rule_that_has_none_leaves_the_usual_one():
    gaussians = gaussians_of([SMALL, LARGE, HUGE])
    densifier = pulled(gaussians, [2e-3, 2e-3, 0.0])
    densifier.edit(gaussians, optimizer_of(gaussians), PARAMS, seeded(), lambda *asked: None)
    usual, _ = edited([SMALL, LARGE, HUGE], [2e-3, 2e-3, 0.0])
    for name, value in gaussians.named_parameters():
        assert torch.equal(value, getattr(usual, name))
