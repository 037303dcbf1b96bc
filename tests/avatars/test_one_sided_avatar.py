"""Colours go on from what was seen, and Gaussians stay near the body."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from deblur_avatar.avatars import limb_bands, one_sided_avatar
from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.closure import COVERED, VIEWS
from deblur_avatar.avatars.one_sided_avatar import (
    OPAQUE,
    OneSidedAvatar,
    OneSidedFitting,
    OneSidedParams,
    Shown,
    inpainted,
    neighbour_weights,
)
from deblur_avatar.avatars.plain_avatar import LOOKS_EVERY, PlainAvatar, PlainParams
from deblur_avatar.geometry.cameras import camera_centres

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
def grey(body, sharpened):
    """A person who stands still, and three frames that are all hers, two of them to fit."""
    params, generator = OneSidedParams(kind="one_sided"), torch.Generator().manual_seed(0)
    betas = torch.zeros(body.shape_dirs.shape[-1])
    model = OneSidedAvatar.create(params, body, betas, 3, 800, "linear", generator)
    with torch.no_grad():
        model.gaussians.opacity_logits.fill_(6.0)
    return model, sharpened(mattes=torch.full((5, 24, 24), 255, dtype=torch.uint8))


@pytest.fixture
def still(swinging):
    return swinging(5, 0.0).at([0] * 5)


def pixels_of(model, front, still):
    """How many pixels each Gaussian colours."""
    return torch.from_numpy(model.shown_pixels(front, still).pixels)


def told_of(model, front, still):
    """What counts for whether a colour is known, and for whether it goes on."""
    shown, places = model.shown_pixels(front, still), model._places()
    known = np.where(places.behind, shown.facing, shown.pixels)
    return torch.from_numpy(known), torch.from_numpy(shown.facing)


def fitting(tiny_parameters, **changes):
    settings = tiny_parameters["avatars"]["one_sided"]["fitting"] | {"least_pixels": 0.01}
    return OneSidedFitting(**settings | {"sure_pixels": 0.01} | changes)


def test_a_back_goes_on_in_the_colours_of_the_front(grey, still, tiny_parameters):
    model, front = grey
    shown = told_of(model, front, still)[0] >= 0.01
    assert 0.2 < shown.float().mean() < 0.9
    with torch.no_grad():
        model.gaussians.features[shown] = torch.tensor(RED).logit()
    before = model.gaussians.features.detach().clone()
    model.inpaint(fitting(tiny_parameters), front, still, finished=True)
    after = model.gaussians.features.detach()
    assert torch.equal((after == before).all(-1), shown)
    assert (before[~shown].sigmoid() - torch.tensor(RED)).abs().max() > 0.3
    assert (after[~shown].sigmoid() - torch.tensor(RED)).abs().max() < 0.01


def test_colours_at_the_edge_of_what_is_seen_stay_and_do_not_go_on(grey, still, tiny_parameters):
    model, front = grey
    pixels, facing = told_of(model, front, still)
    sure = float(pixels[pixels > 0.01].quantile(0.2))
    assert sure < pixels.quantile(0.8)
    well, rim = facing >= sure, (pixels >= 0.01) & (facing < sure)
    assert rim.sum() > 80
    with torch.no_grad():
        model.gaussians.features[rim] = torch.tensor(BLUE).logit()
        model.gaussians.features[well] = torch.tensor(RED).logit()
    model.inpaint(fitting(tiny_parameters, sure_pixels=sure), front, still, finished=True)
    after = model.gaussians.features.detach().sigmoid()
    assert (after[rim] - torch.tensor(BLUE)).abs().max() < 1e-6
    assert (after[~well & ~rim] - torch.tensor(RED)).abs().max() < 0.01


def test_on_the_way_what_shows_too_little_begins_anew(grey, still, tiny_parameters):
    model, front = grey
    pixels, facing = told_of(model, front, still)
    sure = float(pixels.quantile(0.79))
    well, little = facing >= sure, facing < 0.3 * sure
    assert (little & (pixels >= 0.01)).sum() > 100
    assert (~little & ~well).sum() > 20
    with torch.no_grad():
        model.gaussians.features[~well] = torch.tensor(BLUE).logit()
        model.gaussians.features[well] = torch.tensor(RED).logit()
    before = model.gaussians.features.detach().clone()
    model.inpaint(fitting(tiny_parameters, sure_pixels=sure), front, still, finished=False)
    after = model.gaussians.features.detach()
    assert torch.equal(after[~little], before[~little])
    assert (after[little].sigmoid() - torch.tensor(RED)).abs().max() < 0.01


@pytest.mark.parametrize(
    ("finished", "limit", "unknown"), [(True, 0.1, 0.1), (False, 0.1, 0.24), (False, 0.4, 0.4)]
)
@pytest.mark.parametrize("pixels", [1e-3, 1.0])
def test_of_somebody_small_those_go_on_that_show_most(
    grey, still, tiny_parameters, monkeypatch, pixels, finished, limit, unknown
):
    model, front = grey
    count = len(model.gaussians)
    shown = pixels * torch.arange(count) / count
    monkeypatch.setattr(type(model), "shown_pixels", lambda *_: Shown(shown.numpy(), shown.numpy()))
    most = shown >= 0.805 * pixels
    least, more = shown < 0.99 * unknown * pixels, shown >= 1.01 * unknown * pixels
    with torch.no_grad():
        model.gaussians.features[:] = torch.tensor(BLUE).logit()
        model.gaussians.features[most] = torch.tensor(RED).logit()
    limits = {"least_pixels": limit * pixels, "sure_pixels": 1e4 * pixels}
    model.inpaint(fitting(tiny_parameters, **limits), front, still, finished=finished)
    after = model.gaussians.features.detach().sigmoid()
    assert (after[least] - torch.tensor(RED)).abs().max() < 0.01
    assert (after[more & ~most] - torch.tensor(BLUE)).abs().max() < 1e-6


def rendered(model, front, still):
    """What the camera sees of the person in the canonical pose."""
    rotations = torch.eye(3).expand(1, len(model.body.parents), 3, 3)
    transforms = model.transforms(rotations, still.transl[:1])
    state = model.condition(rotations[0], 0, transforms[0], front.camera.viewmat)
    return model.render(state, transforms, front.camera)


def test_what_a_gaussian_shows_is_what_the_picture_has_of_it(grey, still, monkeypatch):
    model, front = grey
    monkeypatch.setattr(one_sided_avatar, "PASSES", 0.0)
    pixels = pixels_of(model, replace(front, train=(0,)), still)
    alpha = rendered(model, front, still).alpha.detach().sum()
    assert float(pixels.sum()) == pytest.approx(float(alpha), rel=1e-3)
    assert torch.equal(pixels_of(model, replace(front, train=(0, 1)), still), pixels)
    # Nearer to the camera there is more to be seen, and the most of all frames counts.
    near = still.at([0, 1, 2, 3, 4])
    near.transl[1, 2] += 0.5
    assert pixels_of(model, replace(front, train=(0, 1)), near).sum() > 1.2 * pixels.sum()
    assert (pixels_of(model, replace(front, train=(0, 1)), near) >= pixels - 1e-6).all()


def test_pixels_count_by_their_mattes_and_where_colours_are_compared(grey, still, monkeypatch):
    model, front = grey
    monkeypatch.setattr(one_sided_avatar, "PASSES", 0.0)
    whole = pixels_of(model, front, still)
    half = pixels_of(model, replace(front, mattes=front.mattes // 2), still)
    assert half.tolist() == pytest.approx((whole * (127 / 255)).tolist(), rel=1e-5)
    left = torch.zeros_like(front.mattes)
    left[..., :12] = 255
    of_left = pixels_of(model, replace(front, comparable=left), still)
    assert torch.equal(pixels_of(model, replace(front, mattes=left), still), of_left)
    assert (of_left <= whole + 1e-6).all()
    assert of_left.sum() == pytest.approx(float(whole.sum() / 2), rel=0.05)  # who stands amid it


def test_what_only_shines_through_the_front_shows_nothing(grey, still, monkeypatch):
    model, front = grey
    with torch.no_grad():
        model.gaussians.opacity_logits.fill_(3.0)  # lets a twentieth through
    shown = model.shown_pixels(front, still)
    monkeypatch.setattr(one_sided_avatar, "PASSES", 0.0)
    through = model.shown_pixels(front, still).pixels
    counts = shown.pixels > 0
    assert (shown.pixels[counts] == through[counts]).all()
    hidden = ~counts & (through > 0)
    assert hidden.mean() > 0.1
    assert through[hidden].max() > 0.05  # more than is needed to be known
    cosines = facing_of(model, front)
    assert (cosines[hidden] < 0.45).all()  # what faces the camera counts
    assert cosines[hidden].mean() < -0.2 < 0.2 < cosines[counts].mean()


def facing_of(model, front):
    """Cosines between the surface at Gaussians and the camera, of who stands before it."""
    return (model._surface().normals @ -front.camera.viewmat[2, :3]).numpy()


def test_what_turns_away_tells_no_colour(grey, still):
    model, front = grey
    shown, cosines = model.shown_pixels(front, still), facing_of(model, front)
    assert ((shown.facing == shown.pixels) | (shown.facing == 0)).all()
    assert (shown.facing[cosines < 0.15] == 0).all()
    assert shown.facing[cosines > 0.45].sum() > 0
    turned = replace(still, global_orient=torch.tensor([[0.0, torch.pi, 0.0]]).expand(5, 3))
    behind = model.shown_pixels(front, turned)
    assert behind.facing[cosines < -0.5].sum() > 0
    assert behind.facing[cosines > 0.2].sum() == 0


def test_frames_that_a_surface_faces_are_told_apart_from_others(grey, still):
    """She comes nearer with her back to the camera: of her front the frame before tells."""
    model, front = grey
    mixed = still.at([0] * 5)
    mixed.global_orient[1, 1] = torch.pi
    mixed.transl[1, 2] += 0.5
    alone = model.shown_pixels(replace(front, train=(0,)), mixed)
    both = model.shown_pixels(replace(front, train=(0, 1)), mixed)
    ahead = facing_of(model, front) > 0.45
    np.testing.assert_array_equal(both.facing[ahead], alone.facing[ahead])


def test_the_camera_may_stand_anywhere(grey, still):
    model, front = grey
    quarter = torch.tensor([[0.0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    moved = replace(front.camera, viewmat=front.camera.viewmat @ quarter.T)
    told = torch.ones(24, 24, 3)
    rotations = torch.eye(3).expand(1, len(model.body.parents), 3, 3)
    at_rest = model._shown(rotations, still.transl[:1], front.camera, told)
    turned = rotations.clone()
    turned[0, 0] = quarter[:3, :3]
    pelvis = model.body.joints[0]
    place = quarter[:3, :3] @ (still.transl[:1] + pelvis)[0] - pelvis
    again = model._shown(turned, place[None], moved, told)
    torch.testing.assert_close(again, at_rest, atol=1e-3, rtol=1e-3)


def test_a_shirt_ends_behind_where_it_ends_before(grey, still, tiny_parameters):
    model, front = grey
    shown, _ = told_of(model, front, still)
    trunk = torch.from_numpy(model._places().limbs == 0)
    height = model.gaussians.means[:, 1].detach()
    hem = height[trunk].median()
    truth = torch.where((height > hem)[:, None], torch.tensor(RED), torch.tensor(BLUE))
    known = shown >= 0.01
    with torch.no_grad():
        colors = torch.where(known[:, None], truth, torch.tensor(GREY))
        model.gaussians.features[:] = colors.logit()
    model.inpaint(fitting(tiny_parameters), front, still, finished=True)
    after = model.gaussians.features.detach().sigmoid()
    asked = trunk & ~known & ((height - hem).abs() > 0.02)
    assert asked.sum() > 20
    torch.testing.assert_close(after[asked], truth[asked], atol=0.01, rtol=0)


def test_of_many_frames_some_are_looked_at_first_and_last_among_them(grey, still, monkeypatch):
    model, front = grey
    seen, render = [], model.render

    def watched(state, transforms, camera):
        seen.append(float(transforms[0, 0, 0, 3]))
        return render(state, transforms, camera)

    monkeypatch.setattr(model, "render", watched)
    monkeypatch.setattr(one_sided_avatar, "LOOKS", 2)
    moving = still.at([0] * 5)
    moving.transl[:, 0] += torch.arange(5) * 0.01
    pixels_of(model, front, moving)  # whose last frame is set aside
    assert seen == pytest.approx([seen[0], seen[0] + 0.03])


def test_what_shows_more_tells_more_of_a_band(grey, still, tiny_parameters):
    model, front = grey
    known, facing = told_of(model, front, still)
    places = model._places()
    limb = torch.from_numpy(places.limbs == places.trunk)
    sure = limb & (facing >= 0.01)
    most = sure & (facing >= facing[sure].quantile(0.6))
    assert facing[most].sum() > 1.2 * facing[sure & ~most].sum()
    with torch.no_grad():
        model.gaussians.features[:] = torch.tensor(BLUE).logit()
        model.gaussians.features[most] = torch.tensor(RED).logit()
    height = model.gaussians.means[:, 1].detach()
    before = model.gaussians.features.detach().clone()
    model.inpaint(fitting(tiny_parameters), front, still, finished=True)
    changed = (model.gaussians.features != before).any(1) & limb
    middle = height[sure].median()
    near = limb & (known < 0.01) & ((height - middle).abs() < 0.05)
    assert near.sum() > 5
    assert changed[near].float().mean() > 0.5  # there red shows more, by fewer


def test_a_limb_that_shows_too_little_goes_on_in_colours_of_its_neighbours(
    grey, still, tiny_parameters, monkeypatch
):
    model, front = grey
    known, _ = told_of(model, front, still)
    monkeypatch.setattr(limb_bands, "FEWEST", 10**6)
    with torch.no_grad():
        model.gaussians.features[known >= 0.01] = torch.tensor(RED).logit()
    model.inpaint(fitting(tiny_parameters), front, still, finished=True)
    colors = model.gaussians.features.detach().sigmoid()
    assert (colors - torch.tensor(RED)).abs().max() < 0.01


def test_limbs_are_measured_in_the_canonical_pose(grey):
    model, _ = grey
    places, means = model._places(), model.gaussians.means.detach()
    shin = torch.from_numpy(places.limbs == model.body.joint_names.index("left_knee"))
    along = torch.from_numpy(places.along)[shin]
    # Its legs are spread by 45 degrees: down and outwards alike.
    slope = torch.tensor([1.0, -1.0, 0.0]) / 2**0.5
    expected = means[shin] @ slope
    assert torch.corrcoef(torch.stack([along, expected]))[0, 1] > 0.99
    assert along.max() - along.min() > 0.3


def test_what_goes_on_from_black_is_finite(grey, still, tiny_parameters):
    model, front = grey
    with torch.no_grad():
        model.gaussians.features.fill_(-200.0)  # whose sigmoid is 0
    model.inpaint(fitting(tiny_parameters), front, still, finished=True)
    assert model.gaussians.features.isfinite().all()


@pytest.mark.parametrize(("least", "sure"), [(1e-9, 1e-9), (1e9, 1e9)])
def test_where_all_or_nothing_is_known_colours_stay(
    grey, still, tiny_parameters, monkeypatch, least, sure
):
    model, front = grey
    monkeypatch.setattr(one_sided_avatar, "FACES", -1.1)  # the back of a head, too
    if least < 1e-3:  # so clear that each shows something
        with torch.no_grad():
            model.gaussians.opacity_logits.fill_(-3.0)
        assert (pixels_of(model, front, still) > least).all()
    before = model.gaussians.features.detach().clone()
    limits = fitting(tiny_parameters, least_pixels=least, sure_pixels=sure)
    model.inpaint(limits, front, still, finished=True)
    assert torch.equal(model.gaussians.features, before)


@pytest.mark.parametrize("name", ["least_pixels", "sure_pixels"])
@pytest.mark.parametrize("least", [0.0, -1.0, math.inf])
def test_no_light_at_all_is_no_limit(tiny_parameters, name, least):
    with pytest.raises(ValueError, match=name):
        fitting(tiny_parameters, **{name: least})


def test_what_is_sure_is_known(tiny_parameters):
    with pytest.raises(ValueError, match="sure_pixels: 0.005 is less than least_pixels, 0.01"):
        fitting(tiny_parameters, sure_pixels=0.005)


def near_body(model, front, still):
    """The penalty on what reaches off the body."""
    step = TrainingStep(1, 1.0, None, torch.Generator())
    return model.regularisers(rendered(model, front, still), step)["near_body"]()


def test_gaussians_beyond_clothes_are_drawn_to_the_body_and_no_others(grey, still):
    model, front = grey
    surface = model._surface()
    with torch.no_grad():
        model.gaussians.log_scales.fill_(-20.0)  # points
        model.gaussians.means.copy_(surface.places + 0.029 * surface.normals)
    model.invalidate_neighbours()
    assert near_body(model, front, still) == 0
    with torch.no_grad():
        model.gaussians.means[:80] += 0.051 * model._surface().normals[:80]
        model.gaussians.means[80:160] -= 0.109 * model._surface().normals[80:160]
    apart = near_body(model, front, still)
    # 80 of 800 stand 8 cm off, and 80 as far inside: 5 cm more than clothes, in centimetres.
    assert apart.item() == pytest.approx(5.0 * 160 / 800, rel=2e-2)
    (pull,) = torch.autograd.grad(apart, model.gaussians.means)
    assert (pull[160:] == 0).all()
    along = (pull * model._surface().normals).sum(-1)
    # Some, between the legs say, are nearer to another part of the body.
    assert along[:80].median().item() == pytest.approx(0.125, rel=1e-3)
    assert along[80:160].median().item() == pytest.approx(-0.125, rel=1e-3)
    assert along[:80].min() >= 0 >= along[80:160].max()


def test_heights_count_the_more_the_less_of_a_person_is_seen(tiny_parameters):
    weighed = fitting(tiny_parameters)
    step = TrainingStep(0, 1.0, weighed, torch.Generator())
    assert weighed.weights(step, 0.0)["near_body"] == 0
    full = weighed.weights(step, 1.0)["near_body"]
    assert full == weighed.regularisers.near_body > 0
    assert weighed.weights(step, 0.5)["near_body"] == pytest.approx(full / 4)


def test_a_gaussian_that_is_thick_across_the_surface_is_flattened_and_no_other(grey, still):
    model, front = grey
    gaussians, surface = model.gaussians, model._surface()
    upright = surface.normals[:, 2].abs().argmax()  # whose z axis is the surface's normal
    with torch.no_grad():
        gaussians.means.copy_(surface.places)
        gaussians.quats[:] = torch.tensor([1.0, 0, 0, 0])
        gaussians.log_scales.fill_(-20.0)
        gaussians.log_scales[upright] = torch.tensor([0.1, 0.1, 0.005]).log()
    model.invalidate_neighbours()
    assert surface.normals[upright, 2].abs() > 0.999
    flat = near_body(model, front, still)
    assert flat.item() < 0.02 * 20 / 800  # wide along the surface
    with torch.no_grad():
        gaussians.log_scales[upright] = torch.tensor([0.005, 0.005, 0.1]).log()
    thick = near_body(model, front, still)
    # Two standard deviations are 20 cm: 17 more than clothes.
    assert thick.item() == pytest.approx(17 / 800, rel=1e-2)
    (pull,) = torch.autograd.grad(thick, gaussians.log_scales)
    assert pull[upright, 2] == pytest.approx(20 / 800, rel=1e-2)
    assert (pull[upright, :2].abs() < 1e-4).all()


def test_a_crown_is_closed_that_a_plain_avatar_may_go_without(grey, body):
    one_sided, _ = grey
    generator = torch.Generator().manual_seed(0)
    plain = PlainAvatar.create(
        PlainParams(kind="plain"), body, one_sided.betas, 3, 800, "linear", generator
    )
    opened = []
    for model in (one_sided, plain):
        top = model.gaussians.means[:, 1].max()
        with torch.no_grad():
            model.gaussians.opacity_logits.fill_(6.0)
            model.gaussians.opacity_logits[model.gaussians.means[:, 1] > top - 0.1] = -30.0
            step = TrainingStep(0, 1.0, None, torch.Generator())
            opened.append(sum(float(model._open_share(look, step)) for look in range(VIEWS)))
    assert opened[0] > 10 * opened[1]


def facing(model, look):
    """Which Gaussians face the camera of a look, by the surface below them."""
    with torch.no_grad():
        eye = camera_centres(model._view(look).camera.viewmat)
        towards = eye - model.gaussians.means
        return (model._surface().normals * towards).sum(1) > 0


def opaque_terms(model, front, still, look):
    """What closes a surface and what shines through it, seen from one side."""
    step = TrainingStep(LOOKS_EVERY * look, 1.0, None, torch.Generator())
    terms = model.regularisers(rendered(model, front, still), step)
    return terms["closed"](), terms["opaque"]()


@pytest.fixture
def dense(body):
    """An avatar whose front alone hides what is behind it."""
    params, generator = OneSidedParams(kind="one_sided"), torch.Generator().manual_seed(0)
    betas = torch.zeros(body.shape_dirs.shape[-1])
    model = OneSidedAvatar.create(params, body, betas, 3, 4000, "linear", generator)
    with torch.no_grad():
        model.gaussians.opacity_logits.fill_(6.0)
        model.gaussians.log_scales += 0.3
    return model


@pytest.mark.parametrize("look", [0, 5])
def test_what_turns_away_shines_through_a_thin_front_and_not_through_an_opaque_one(
    dense, grey, still, look
):
    def terms(facing_logit, turned_logit):
        with torch.no_grad():
            logits = dense.gaussians.opacity_logits
            logits.copy_(torch.where(facing(dense, look), facing_logit, turned_logit))
            return [term.item() for term in opaque_terms(dense, grey[1], still, look)]

    assert terms(6.0, -30.0) == [0.0, 0.0]
    assert max(terms(6.0, 6.0)) < 0.1  # an arm's far side, before the trunk's near one
    closed, opaque = terms(-3.0, 6.0)
    assert closed > 0.5
    assert opaque - closed == pytest.approx(LOOKS_EVERY * (OPAQUE - COVERED), abs=0.2)
    plain = PlainAvatar._open_share(dense, look, TrainingStep(0, 1.0, None, torch.Generator()))
    assert plain.item() == 0.0  # what turns away closes it for him


def test_a_front_becomes_opaque_by_opacities_alone_and_the_back_stays(dense, grey, still):
    hides = facing(dense, 0)
    with torch.no_grad():
        dense.gaussians.opacity_logits[hides] = -1.5
    _, shines = opaque_terms(dense, grey[1], still, 0)
    parameters = dict(dense.gaussians.named_parameters())
    pulls = torch.autograd.grad(shines, list(parameters.values()), allow_unused=True)
    found = {name: pull for name, pull in zip(parameters, pulls, strict=True) if pull is not None}
    own = found.pop("opacity_logits")
    assert all((pull == 0).all() for pull in found.values())
    assert own[hides].sum() < 10 * -own[~hides].abs().sum() < 0


def test_nothing_shines_through_whatever_is_seen_and_every_third_step_looks(
    grey, still, tiny_parameters
):
    weighed = fitting(tiny_parameters)
    steps = [TrainingStep(turn, 1.0, weighed, torch.Generator()) for turn in range(LOOKS_EVERY)]
    weights = [weighed.weights(steps[0], share)["opaque"] for share in (0.0, 0.04, 0.5)]
    assert weights == [weighed.regularisers.opaque] * 3
    assert weights[0] > 0
    model, front = grey
    terms = [model.regularisers(rendered(model, front, still), step) for step in steps]
    assert ["opaque" in found for found in terms] == [True, *[False] * (LOOKS_EVERY - 1)]
