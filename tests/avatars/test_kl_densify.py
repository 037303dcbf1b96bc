import math

import pytest
import torch

from deblur_avatar.avatars.gaussians import Gaussians
from deblur_avatar.avatars.kl_densify import (
    KlDensifyParams,
    disjoint_pairs,
    divergence_from_nearest,
    kl_divergence,
    kl_edits,
    merge,
)
from deblur_avatar.geometry.rotations import quat_multiply, quat_to_matrix
from deblur_avatar.training.densify import Densifier
from tests.randomness import seeded

pytestmark = pytest.mark.portable

CPU = torch.device("cpu")
SMALL, LARGE = 0.005, 0.012  # metres
PULLED, STILL = 1e-3, 1e-5
PARAMS = KlDensifyParams(
    start=1, stop=100, every=10, gradient=2e-4, clone_below_m=0.01, prune_opacity=0.005,
    prune_scale_m=10.0, max_growth=3.0, kl_split=0.4, kl_merge=0.1, body_distance_m=0.05,
)  # fmt: skip
STILL_QUAT = torch.tensor([1.0, 0, 0, 0])


def along(*places, scales, opacities=None):
    """Round Gaussians along x, whose features say which is which."""
    count = len(places)
    means = torch.zeros(count, 3)
    means[:, 0] = torch.tensor(places)
    opacities = [0.5] * count if opacities is None else opacities
    return Gaussians(
        means, STILL_QUAT.repeat(count, 1), torch.tensor(scales).log()[:, None].repeat(1, 3),
        torch.tensor(opacities).logit(), torch.arange(2.0 * count).reshape(count, 2),
    )  # fmt: skip


def edited(gaussians, pulls, room=100, params=PARAMS, vertices=None):
    vertices = gaussians.means.detach().clone() if vertices is None else vertices
    with torch.no_grad():
        return kl_edits(gaussians, torch.tensor(pulls), params, room, vertices, seeded())


def normal(seed, dtype=torch.float64):
    drawn = torch.randn(4, 10, generator=seeded(seed), dtype=dtype)
    return drawn[:, :3], drawn[:, 3:7], 0.3 * drawn[:, 7:]


def test_divergence_of_a_pair_by_hand():
    one = torch.zeros(1, 3), STILL_QUAT[None], torch.zeros(1, 3)
    # Twice as wide along x, 3 away along y: (1/4 + 1 + 1 + 9 - 3 + ln 4) / 2.
    other = (
        torch.tensor([[0.0, 3, 0]]), STILL_QUAT[None], torch.tensor([[math.log(2), 0, 0]])
    )  # fmt: skip
    wanted = torch.tensor([(0.25 + 1 + 1 + 9 - 3 + math.log(4)) / 2])
    torch.testing.assert_close(kl_divergence(*one, *other), wanted)
    # And the other way round: (4 + 1 + 1 + 9 - 3 - ln 4) / 2.
    wanted = torch.tensor([(4 + 1 + 1 + 9 - 3 - math.log(4)) / 2])
    torch.testing.assert_close(kl_divergence(*other, *one), wanted)


def test_divergence_is_that_of_torchs_distributions():
    one, other = normal(0), normal(1)

    def distribution(means, quats, log_scales):
        factor = quat_to_matrix(quats) * log_scales.exp()[:, None, :]
        return torch.distributions.MultivariateNormal(means, factor @ factor.mT)

    wanted = torch.distributions.kl_divergence(distribution(*one), distribution(*other))
    torch.testing.assert_close(kl_divergence(*one, *other), wanted)


def test_divergence_is_0_from_itself_and_stays_when_both_are_moved_and_turned():
    (means, quats, scales), other = normal(2), normal(3)
    itself = kl_divergence(means, quats, scales, means, quats, scales)
    torch.testing.assert_close(itself, torch.zeros(4, dtype=torch.float64), atol=1e-12, rtol=0)
    turn = torch.nn.functional.normalize(torch.randn(4, generator=seeded()).double(), dim=0)
    moved = [
        (means @ quat_to_matrix(turn).T + 5, quat_multiply(turn.expand(4, 4), quats), scales)
        for means, quats, scales in ((means, quats, scales), other)
    ]
    torch.testing.assert_close(
        kl_divergence(*moved[0], *moved[1]), kl_divergence(means, quats, scales, *other)
    )


def test_a_gaussian_diverges_from_the_one_that_is_nearest():
    gaussians = along(0.0, 0.01, 0.03, scales=[0.01, 0.01, 0.01])
    nearest, divergence = divergence_from_nearest(gaussians)
    assert nearest.tolist() == [1, 0, 1]
    torch.testing.assert_close(divergence, torch.tensor([0.5, 0.5, 2.0]))


def test_what_is_not_pulled_stays():
    gaussians = along(0.0, 0.001, 0.1, scales=[SMALL, SMALL, LARGE])
    keep, added = edited(gaussians, [STILL] * 3)
    assert keep.tolist() == [True] * 3
    assert [len(part["means"]) for part in added] == [0, 0, 0, 0]


def test_a_small_gaussian_unlike_the_nearest_gets_a_companion_within_it():
    gaussians = along(0.0, 0.02, scales=[SMALL, SMALL])
    keep, (_, clones, *halves) = edited(gaussians, [PULLED, STILL])
    assert keep.tolist() == [True, True]
    assert clones["features"].tolist() == [[0.0, 1.0]]
    assert [len(part["means"]) for part in halves] == [0, 0]
    offset = clones["means"] - gaussians.means[:1]
    assert 0 < float(offset.detach().norm()) < 5 * SMALL
    torch.testing.assert_close(clones["log_scales"], gaussians.log_scales.data[:1])


def test_a_large_one_gives_way_to_two_that_are_narrower():
    gaussians = along(0.0, 0.08, scales=[LARGE, LARGE])
    keep, (_, clones, *halves) = edited(gaussians, [STILL, PULLED])
    assert keep.tolist() == [True, False]
    assert len(clones["means"]) == 0
    for half in halves:
        assert half["features"].tolist() == [[2.0, 3.0]]
        torch.testing.assert_close(half["log_scales"].exp(), torch.full((1, 3), LARGE / 1.6))
    assert not torch.equal(halves[0]["means"], halves[1]["means"])


@pytest.mark.parametrize(("scale", "kept", "new"), [(SMALL, True, 1), (LARGE, False, 2)])
def test_one_that_is_alone_is_unlike_any_other(scale, kept, new):
    keep, added = edited(along(0.0, scales=[scale]), [PULLED])
    assert keep.tolist() == [kept]
    assert sum(len(part["means"]) for part in added) == new


@pytest.mark.parametrize("scale", [SMALL, LARGE])
def test_those_that_overlap_with_the_nearest_neither_split_nor_multiply(scale):
    gaussians = along(0.0, 0.7 * scale, scales=[scale, scale])  # a divergence of 0.245
    keep, added = edited(gaussians, [PULLED, PULLED])
    assert keep.tolist() == [True, True]
    assert sum(len(part["means"]) for part in added) == 0


def test_small_ones_that_are_alike_become_one():
    gaussians = along(0.0, 0.001, 0.5, scales=[SMALL, 0.0052, SMALL], opacities=[0.2, 0.6, 0.5])
    keep, (merged, *others) = edited(gaussians, [PULLED, PULLED, STILL])
    assert keep.tolist() == [False, False, True]
    assert sum(len(part["means"]) for part in others) == 0
    torch.testing.assert_close(merged["means"], torch.tensor([[0.0005, 0, 0]]))
    torch.testing.assert_close(merged["features"], torch.tensor([[1.0, 2.0]]))
    logits = torch.tensor([0.2, 0.6]).logit()
    torch.testing.assert_close(merged["opacity_logits"], logits.mean()[None])


def test_large_ones_that_are_alike_stay_two():
    gaussians = along(0.0, 0.001, scales=[LARGE, LARGE])
    keep, added = edited(gaussians, [PULLED, PULLED])
    assert keep.tolist() == [True, True]
    assert sum(len(part["means"]) for part in added) == 0


def test_a_merged_gaussian_has_its_firsts_turn_and_is_wider_than_it():
    gaussians = along(0.0, 0.001, scales=[SMALL, 2 * SMALL])
    with torch.no_grad():
        gaussians.quats[1] = torch.tensor([0.0, 1, 0, 0])
    for pair, scale in (([0, 1], SMALL), ([1, 0], 2 * SMALL)):
        part = merge(gaussians, torch.tensor([pair]))
        torch.testing.assert_close(part["log_scales"].exp(), torch.full((1, 3), scale / 0.8))
        assert torch.equal(part["quats"][0], gaussians.quats[pair[0]])


def test_nobody_is_merged_twice_and_the_most_alike_come_first():
    nearest = torch.tensor([1, 0, 1, 4, 3])
    divergence = torch.tensor([0.05, 0.04, 0.01, 0.03, 0.03])
    everyone = torch.arange(5)
    pairs = disjoint_pairs(everyone, nearest, divergence)
    assert pairs.tolist() == [[2, 1], [3, 4]]  # 0 and 1 would have been, had 1 been free
    assert disjoint_pairs(everyone[:0], nearest, divergence).shape == (0, 2)
    assert disjoint_pairs(torch.tensor([4]), nearest, divergence).tolist() == [[4, 3]]


def test_who_is_merged_has_no_other_part_in_an_edit():
    # 0 merges with 1, whose own nearest is 2, a tiny one that is nothing like it.
    gaussians = along(0.0, 0.001, 0.0015, scales=[SMALL, SMALL, SMALL / 25])
    keep, (merged, clones, *_) = edited(gaussians, [PULLED] * 3)
    assert keep.tolist() == [False, False, True]
    assert merged["features"].tolist() == [[1.0, 2.0]]
    assert clones["features"].tolist() == [[4.0, 5.0]]


def test_growth_ends_where_there_is_no_room_and_the_strongest_come_first():
    gaussians = along(0.0, 0.02, 0.04, scales=[SMALL] * 3)
    keep, (_, clones, *_) = edited(gaussians, [1e-3, 3e-3, 2e-3], room=2)
    assert keep.tolist() == [True] * 3
    assert clones["features"][:, 0].tolist() == [2.0, 4.0]
    assert len(edited(gaussians, [1e-3, 3e-3, 2e-3], room=0)[1][1]["means"]) == 0


def test_faint_ones_and_those_off_the_body_go():
    gaussians = along(0.0, 0.04, 0.06, 0.2, scales=[SMALL] * 4, opacities=[0.004, 0.5, 0.5, 0.5])
    keep, _ = edited(gaussians, [STILL] * 4, vertices=torch.tensor([[0.0, 0, 0], [0.24, 0, 0]]))
    assert keep.tolist() == [False, True, False, True]


def test_those_that_are_added_off_the_body_go_at_once():
    gaussians = along(0.0, 0.3, scales=[LARGE, LARGE])
    params = PARAMS.model_copy(update={"body_distance_m": 1e-4})
    keep, added = edited(gaussians, [PULLED, STILL], params=params)
    assert keep.tolist() == [False, True]
    assert [len(part["means"]) for part in added] == [0, 0, 0, 0]


def test_the_same_draws_give_the_same_edits():
    gaussians = along(0.0, 0.08, 0.1, scales=[LARGE, LARGE, SMALL])
    first, second = (edited(gaussians, [PULLED] * 3) for _ in range(2))
    assert torch.equal(first[0], second[0])
    for one, other in zip(first[1], second[1], strict=True):
        assert all(torch.equal(value, other[name]) for name, value in one.items())


def test_a_pair_less_is_one_gaussian_less_and_adams_memory_follows():
    gaussians = along(0.0, 0.001, 0.5, 0.6, scales=[SMALL] * 4)
    groups = [{"params": [p], "names": [name]} for name, p in gaussians.named_parameters()]
    optimizer = torch.optim.Adam(groups, lr=0.0)
    for parameter in gaussians.parameters():
        row = torch.arange(1.0, 5)
        parameter.grad = row.reshape(-1, *[1] * (parameter.ndim - 1)).expand_as(parameter)
    optimizer.step()
    densifier = Densifier(4, CPU)
    gradients = torch.zeros(1, 4, 2)
    gradients[0, :2, 0] = PULLED
    densifier.observe(gradients, torch.ones(1, 4, dtype=torch.int32), 2, 2)
    vertices = gaussians.means.detach().clone()

    def rule(pulls, params, room, generator):
        return kl_edits(gaussians, pulls, params, room, vertices, generator)

    densifier.edit(gaussians, optimizer, PARAMS, seeded(), rule)
    assert len(gaussians) == 3
    for group in optimizer.param_groups:
        (parameter,) = group["params"]
        memory = optimizer.state[parameter]
        assert parameter is getattr(gaussians, group["names"][0])
        assert memory["exp_avg"].shape == parameter.shape
        kept = 0.1 * torch.tensor([3.0, 4.0, 0.0])  # two that stayed, and the new one
        wanted = kept.reshape(-1, *[1] * (parameter.ndim - 1)).expand_as(parameter)
        torch.testing.assert_close(memory["exp_avg"], wanted)
