"""Tests of growth: Gaussians that become several."""

import pytest
import torch

from deblur_avatar.avatars.gaussians import Gaussians
from deblur_avatar.rendering.covariance_factors import covariance_factors, covariances
from deblur_avatar.rendering.rasterize import rasterize
from deblur_avatar.training.growth import morton_codes, multiply_gaussians
from tests.randomness import seeded


def fog(count=400):
    """Gaussians on a plate one metre wide, two metres before the camera."""
    means = torch.rand(count, 3, generator=seeded()) - 0.5
    means[:, 2] = 2.0
    return Gaussians(
        means=means,
        quats=torch.randn(count, 4, generator=seeded(1)),
        log_scales=(0.03 + 0.02 * torch.rand(count, 3, generator=seeded(2))).log(),
        opacity_logits=torch.full((count,), 0.3).logit(),
        features=0.5 + 0.3 * torch.sin(7 * means),
    )


def optimizer_of(gaussians, rate=0.0):
    groups = [{"params": [p], "names": [name]} for name, p in gaussians.named_parameters()]
    optimizer = torch.optim.Adam(groups, lr=rate, fused=True)
    for parameter in gaussians.parameters():
        parameter.grad = torch.ones_like(parameter)
    optimizer.step()
    optimizer.zero_grad()
    return optimizer


def picture(gaussians):
    factors = covariance_factors(gaussians.quats, gaussians.scales)
    K = torch.tensor([[80.0, 0, 32], [0, 80, 32], [0, 0, 1]])
    with torch.no_grad():
        return rasterize(
            gaussians.means[None], covariances(factors), gaussians.opacities, gaussians.features,
            torch.eye(4), K, 64, 64,
        ).image[0]  # fmt: skip


@pytest.mark.portable
def test_a_picture_stays_what_it_was_when_gaussians_multiply():
    gaussians = fog()
    before = picture(gaussians)
    multiply_gaussians(gaussians, optimizer_of(fog()), 400, seeded())  # as many: nothing happens
    assert torch.equal(picture(gaussians), before)
    grown = fog()
    multiply_gaussians(grown, optimizer_of(grown), 1600, seeded())
    assert len(grown) == 1600
    apart = (picture(grown) - before).square().mean().sqrt()
    assert apart < 0.35 * before.std()
    # Children as wide as their parents would cover far more.
    with torch.no_grad():
        grown.log_scales += 0.5 * torch.tensor(4.0).log()
    assert (picture(grown) - before).square().mean().sqrt() > 2 * apart


def test_children_share_the_area_of_their_parent_and_surround_it():
    gaussians = fog(50)
    parents = gaussians.means.detach().clone()
    area = gaussians.scales.square().sum(0).detach()
    multiply_gaussians(gaussians, optimizer_of(gaussians), 200, seeded())
    torch.testing.assert_close(gaussians.scales.square().sum(0).detach(), area)
    nearest = torch.cdist(gaussians.means.detach(), parents).amin(1)
    assert 0.005 < nearest.mean() < 0.06


@pytest.mark.parametrize("count", [51, 75, 149])
def test_any_number_of_gaussians_can_be_asked_for(count):
    gaussians = fog(50)
    before = {tuple(row) for row in gaussians.means.tolist()}
    multiply_gaussians(gaussians, optimizer_of(gaussians), count, seeded())
    assert len(gaussians) == count
    kept = before & {tuple(row) for row in gaussians.means.tolist()}
    assert len(kept) == max(0, 2 * 50 - count)  # who has no sibling stays where it was


def test_the_optimizer_forgets_and_goes_on_with_the_new_gaussians():
    gaussians = fog(20)
    optimizer = optimizer_of(gaussians, rate=1e-3)
    multiply_gaussians(gaussians, optimizer, 80, seeded())
    assert not optimizer.state
    held = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    assert all(one is other for one, other in zip(held, gaussians.parameters(), strict=True))
    before = gaussians.means.detach().clone()
    for parameter in gaussians.parameters():
        parameter.grad = torch.ones_like(parameter)
    optimizer.step()
    torch.testing.assert_close(before - gaussians.means.detach(), torch.full((80, 3), 1e-3))


def test_the_same_draws_make_the_same_children():
    first, second = fog(30), fog(30)
    for gaussians in (first, second):
        multiply_gaussians(gaussians, optimizer_of(gaussians), 100, seeded(5))
    assert torch.equal(first.means, second.means)


def test_rows_follow_a_curve_through_space():
    points = torch.rand(2000, 3, generator=seeded())
    order = morton_codes(points).argsort()
    along = points[order].diff(dim=0).norm(dim=1).mean()
    assert along < 0.35 * points.diff(dim=0).norm(dim=1).mean()
    corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    codes = morton_codes(corners)
    assert codes[0] == 0
    assert (codes[1:] > 0).all()
    assert len(set(codes.tolist())) == 4
    assert morton_codes(torch.zeros(3, 3)).tolist() == [0, 0, 0]
