"""Colours that nothing has shown go on from those that something has."""

import math

import numpy as np
import pytest
import torch

from deblur_avatar.avatars.inpainted_avatar import (
    InpaintedAvatar,
    InpaintedFitting,
    InpaintedParams,
    inpainted,
    neighbour_weights,
)

GREY, RED, BLUE = [0.5] * 3, [0.8, 0.1, 0.1], [0.1, 0.1, 0.8]


def sheet(rows: int, columns: int) -> np.ndarray:
    """Points a centimetre apart."""
    y, x = np.mgrid[:rows, :columns]
    return np.stack([x.ravel() * 0.01, y.ravel() * 0.01, np.zeros(x.size)], -1)


def test_what_is_known_stays_and_one_colour_around_is_the_colour_within():
    generator = np.random.default_rng(3)
    points = generator.normal(size=(300, 3))
    known = points[:, 2] > 0
    values = np.where(known[:, None], [RED], [GREY])
    filled = inpainted(points, values, known)
    assert (filled[known] == values[known]).all()
    np.testing.assert_allclose(filled, [RED] * 300, atol=1e-3)


def test_a_border_goes_on_across_what_is_unknown():
    """Red above, blue below, left and right of a gap of grey: the shortest border is straight."""
    points = sheet(20, 30)
    truth = np.where(points[:, 1:2] < 0.095, [RED], [BLUE])
    known = (points[:, 0] < 0.105) | (points[:, 0] > 0.185)
    values = np.where(known[:, None], truth, [GREY])
    filled = inpainted(points, values, known)
    away = np.abs(points[:, 1] - 0.095) > 0.02
    np.testing.assert_allclose(filled[away], truth[away], atol=0.05)


def test_values_stay_among_those_that_are_known():
    generator = np.random.default_rng(5)
    points, values = generator.normal(size=(200, 3)), generator.random((200, 3))
    known = points[:, 0] > 0.3
    filled = inpainted(points, values, known)
    low, high = values[known].min(0), values[known].max(0)
    assert ((filled >= low - 1e-6) & (filled <= high + 1e-6)).all()


def test_neither_order_nor_place_nor_size_matters():
    generator = np.random.default_rng(4)
    points, values = generator.normal(size=(200, 3)), generator.random((200, 3))
    known = points[:, 0] > 0
    filled = inpainted(points, values, known)
    moved = inpainted(3 * points + 5, values, known)
    np.testing.assert_allclose(moved, filled, atol=1e-6)
    order = generator.permutation(200)
    other = inpainted(points[order], values[order], known[order])
    np.testing.assert_allclose(other, filled[order], atol=1e-6)


def test_what_no_known_point_is_connected_with_becomes_its_mean():
    near, far = sheet(1, 12), sheet(1, 12) + 100.0
    values = np.concatenate([np.full((12, 1), 0.9), np.full((6, 1), 0.2), np.full((6, 1), 0.4)])
    known = np.arange(24) < 12
    filled = inpainted(np.concatenate([near, far]), values, known)
    np.testing.assert_allclose(filled[12:], 0.3, atol=1e-2)


def test_neighbours_weigh_by_nearness_both_ways_and_none_itself():
    points = np.random.default_rng(6).normal(size=(100, 3))
    weights = neighbour_weights(points).toarray()
    assert (weights == weights.T).all()
    assert (np.diag(weights) == 0).all()
    assert ((weights > 0).sum(1) >= 8).all()
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    order = np.argsort(apart[weights > 0])
    assert (np.diff(weights[weights > 0][order]) <= 0).all()
    assert weights[weights > 0].max() > 2 * weights[weights > 0].min()


@pytest.fixture
def grey(body, swinging):
    """A person who stands still, and her pose in three frames."""
    params, generator = InpaintedParams(kind="inpainted"), torch.Generator().manual_seed(0)
    betas = torch.zeros(body.shape_dirs.shape[-1])
    model = InpaintedAvatar.create(params, body, betas, 3, 800, "linear", generator)
    with torch.no_grad():
        model.gaussians.opacity_logits.fill_(6.0)
    return model, swinging(3, 0.0)


def fitting(tiny_parameters, **changes):
    return InpaintedFitting(**tiny_parameters["avatars"]["inpainted"]["fitting"] | changes)


def test_a_back_goes_on_in_the_colours_of_the_front(grey, front, tiny_parameters):
    model, poses = grey
    shown = model.most_pixels(poses, front.camera(0)) >= 0.01
    assert 0.2 < shown.float().mean() < 0.9
    with torch.no_grad():
        model.gaussians.features[shown] = torch.tensor(RED).logit()
    before = model.gaussians.features.detach().clone()
    model.inpaint(fitting(tiny_parameters, least_pixels=0.01), poses, front.camera(0))
    after = model.gaussians.features.detach()
    assert torch.equal((after == before).all(-1), shown)
    assert (before[~shown].sigmoid() - torch.tensor(RED)).abs().max() > 0.3
    assert (after[~shown].sigmoid() - torch.tensor(RED)).abs().max() < 0.01


def test_what_a_gaussian_shows_is_what_the_picture_has_of_it(grey, front):
    model, poses = grey
    camera = front.camera(0)
    pixels = model.most_pixels(poses.at([0]), camera)
    rotations = torch.eye(3).expand(1, len(model.body.parents), 3, 3)
    transforms = model.transforms(rotations, poses.transl[:1])
    state = model.condition(rotations[0], 0, transforms[0], camera.viewmat)
    alpha = model.render(state, transforms, camera).alpha.detach().sum()
    assert float(pixels.sum()) == pytest.approx(float(alpha), rel=1e-3)
    assert torch.equal(model.most_pixels(poses.at([0, 0]), camera), pixels)
    # Nearer to the camera there is more to be seen, and the most of all frames counts.
    near = poses.at([0, 0])
    near.transl[1, 2] += 0.5
    assert model.most_pixels(near, camera).sum() > 1.2 * pixels.sum()
    assert (model.most_pixels(near, camera) >= pixels - 1e-6).all()


def test_of_many_frames_some_are_looked_at_first_and_last_among_them(grey, front, monkeypatch):
    model, poses = grey
    seen, render = [], model.render

    def watched(state, transforms, camera):
        seen.append(float(transforms[0, 0, 0, 3]))
        return render(state, transforms, camera)

    monkeypatch.setattr(model, "render", watched)
    many = poses.at([0] * 100)
    many.transl[:, 0] += torch.arange(100) * 1e-4
    model.most_pixels(many, front.camera(0))
    assert len(seen) == 48
    assert max(seen) - min(seen) == pytest.approx(99e-4, rel=1e-3)


def test_what_goes_on_from_black_is_finite(grey, front, tiny_parameters):
    model, poses = grey
    with torch.no_grad():
        model.gaussians.features.fill_(-200.0)  # whose sigmoid is 0
    model.inpaint(fitting(tiny_parameters, least_pixels=0.01), poses, front.camera(0))
    assert model.gaussians.features.isfinite().all()


@pytest.mark.parametrize("least", [1e-9, 1e9])
def test_where_all_or_nothing_is_known_colours_stay(grey, front, tiny_parameters, least):
    model, poses = grey
    if least < 1:  # so clear that each shows something
        with torch.no_grad():
            model.gaussians.opacity_logits.fill_(-3.0)
        assert (model.most_pixels(poses, front.camera(0)) > least).all()
    before = model.gaussians.features.detach().clone()
    model.inpaint(fitting(tiny_parameters, least_pixels=least), poses, front.camera(0))
    assert torch.equal(model.gaussians.features, before)


@pytest.mark.parametrize("least", [0.0, -1.0, math.inf])
def test_no_light_at_all_is_no_limit(tiny_parameters, least):
    with pytest.raises(ValueError, match="least_pixels"):
        fitting(tiny_parameters, least_pixels=least)
