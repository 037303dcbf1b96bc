import math
from functools import partial

import pytest
import torch

from deblur_avatar.avatars.arah_small_avatar import ArahSmallAvatar
from deblur_avatar.avatars.arah_small_params import ArahSmallParams
from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.body_distance import outer_surface, signed_distances
from deblur_avatar.avatars.forward_skinning import ForwardSkinning
from deblur_avatar.avatars.gaussians import sample_surface
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.config.reading import parse
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import invert_rigid
from deblur_avatar.training.params import RecipeParams
from tests.avatars.avatar_checks import (
    CPU,
    all_unknowns_are_in_networks,
    drawn,
    fitted,
    fitted_twice,
    is_drawn_as_saved,
    model_is_refused,
    nothing_exports_it,
    rates_of_all_unknowns,
    state_of,
    stopped_ends_with_the_same_bytes,
)
from tests.changed_parameters import changed
from tests.randomness import seeded

pytestmark = pytest.mark.portable

FRAMES = 5


def small(content):
    content["model"] |= {
        "precision": "float32",
        "sdf": {
            "hidden": [64, 64, 64],
            "frequency": 30.0,
            "latent": 3,
            "width_m": 0.01,
            "pretrain": 350,
        },
        "skinning": {"hidden": [64, 64], "pretrain": 400, "nodes": 24},
        "color": {"hidden": [16]},
        "samples": {"near": 9, "front": 3, "free": 8, "band_m": 0.05},
    }
    content["fitting"]["rays"] = {"patches": 60, "size": 1, "on_person": 0.5, "coarse": 4}
    return content


@pytest.fixture
def content(tiny_content):
    return small(tiny_content["avatars"]["arah_small"])


@pytest.fixture
def recipe(content):
    return parse(RecipeParams, content, "avatars.arah_small")


@pytest.fixture(scope="module")
def saved(body, tiny_parameters):
    """One that knows the body, and different colours and surfaces in different frames and poses."""
    import copy

    content = small(copy.deepcopy(tiny_parameters["avatars"]["arah_small"]))
    recipe = parse(RecipeParams, content, "avatars.arah_small")
    torch.manual_seed(0)
    betas = torch.tensor([0.3, 0.2])
    avatar = ArahSmallAvatar.create(recipe.model, body, betas, FRAMES, 1, "srgb", seeded())
    avatar.pretrain(seeded(1))
    with torch.no_grad():
        avatar.latents.codes.normal_(std=0.5, generator=seeded(2))
        avatar.sdf.modulation.weight.normal_(std=0.002, generator=seeded(3))
        avatar.color_network.last.weight.normal_(std=0.5, generator=seeded(4))
    return avatar.to_artifact(3)


@pytest.fixture
def avatar(saved, body):
    return avatar_from_artifact(saved, body, CPU)


@pytest.fixture
def bent(body):
    return 0.15 * torch.randn(len(body.parents), 3, generator=seeded(7))  # radians


@pytest.fixture
def camera(front):
    return front.camera(0)


def joint_places(avatar):
    """In the canonical pose."""
    back = invert_rigid(avatar.rest_from_canonical)
    rest = avatar.body.joints + avatar.body.joint_dirs @ avatar.betas
    return (back[:, :3, :3] @ rest[..., None])[..., 0] + back[:, :3, 3]


def step_at(recipe, iteration, generator=None):
    return TrainingStep(iteration, 1.0, recipe.fitting, generator or seeded())


def test_its_networks_are_as_large_as_said(tiny_content, body):
    recipe = parse(RecipeParams, tiny_content["avatars"]["arah_small"], "avatars.arah_small")
    avatar = ArahSmallAvatar.create(recipe.model, body, torch.zeros(2), 4, 1, "srgb", seeded())
    assert [layer.in_features for layer in avatar.sdf.layers] == [3, 64, 64, 64, 64]
    assert avatar.sdf.seen.in_features == 144 + 16
    assert [layer.in_features for layer in avatar.color_network.layers] == [3 + 3 + 64 + 16, 64, 64]
    assert avatar.latents.codes.shape == (4, 16)
    assert avatar.log_width.exp().item() == pytest.approx(0.01)
    assert avatar.densified is None


def test_it_begins_with_the_bodys_surface_and_the_bodys_weights(avatar):
    vertices, faces = avatar.canonical_vertices, avatar.faces
    points = outer_surface(vertices, faces, 500, seeded(9))
    still = avatar.sdf.modulated(torch.zeros(avatar.sdf.seen.in_features))
    distances, _, gradients = avatar.sdf.normals(points, still)
    assert distances.abs().median() < 8e-3  # metres; of a network this small
    assert gradients.norm(dim=1).median().item() == pytest.approx(1.0, abs=0.3)
    points, chosen, corners = sample_surface(vertices, faces, 500, seeded(9))
    wanted = (corners[..., None] * avatar.lbs_weights[faces[chosen]]).sum(1)
    assert (avatar.weights_at(points) - wanted).abs().sum(1).mean() < 0.6


def test_its_silhouette_is_the_bodys(avatar, bent, camera):
    large = camera.binned(0.5)
    large = type(camera)(4 * large.K, camera.viewmat, 48, 48)
    large.K[2, 2] = 1
    alpha = drawn(avatar, bent, large).alpha[0]
    body = avatar.body_pixels(state_of(avatar, bent)[1], large)
    assert alpha[body].mean() > 0.6
    assert (alpha > 0.5)[~body].float().mean() < 0.12


def test_the_grid_is_baked_anew_when_weights_have_moved(avatar):
    before = avatar.baked_weights()
    assert avatar.baked_weights() is before
    with torch.no_grad():
        avatar.skinning_field.network.last.bias.normal_(generator=seeded(5))
    assert avatar.baked_weights() is before
    avatar.invalidate_neighbours()
    assert not torch.allclose(avatar.baked_weights().weights, before.weights)


def test_surface_and_colours_depend_on_pose_and_frame_but_not_on_how_the_body_is_turned(
    avatar, bent
):
    points = avatar.canonical_vertices[:50]

    def seen(angles, frame=0):
        state, _ = state_of(avatar, angles, frame=frame)
        colors, densities = avatar.surface_colors(points, state)
        return torch.cat([colors, densities[:, None]], dim=1)

    turned, other = bent.clone(), bent.clone()
    turned[0] = torch.tensor([0.0, 2.0, 0.0])
    other[7] = turned[0]
    assert torch.equal(seen(bent), seen(turned))
    assert not torch.allclose(seen(bent), seen(other), atol=1e-4)
    assert not torch.allclose(seen(bent), seen(bent, 1), atol=1e-4)
    torch.testing.assert_close(seen(bent, 99), seen(bent, FRAMES - 1))


def test_there_is_noise_on_the_pose_in_half_of_the_steps_of_fitting(avatar, bent, recipe):
    clean, _ = state_of(avatar, bent)
    generator, noisy = seeded(), 0
    for _ in range(40):
        state, _ = state_of(avatar, bent, step=step_at(recipe, 1, generator))
        noisy += not torch.equal(state.modulation[0][0], clean.modulation[0][0])
    assert 10 < noisy < 30
    still = changed(recipe, "fitting", pose_noise=0.0)
    state, _ = state_of(avatar, bent, step=step_at(still, 1))
    assert torch.equal(state.modulation[0][0], clean.modulation[0][0])


def test_a_ball_covers_its_disc_of_a_picture(avatar, front, monkeypatch):
    radius = 0.05
    middle = joint_places(avatar)[15] + torch.tensor([0.0, 0.06, 0.01])  # within the head

    def ball(points, modulation):
        return (points - middle).norm(dim=1) - radius, points.new_zeros(len(points), 64)

    monkeypatch.setattr(avatar.sdf, "forward", ball)
    with torch.no_grad():
        avatar.log_width.fill_(math.log(5e-4))
        for value in avatar.color_network.last.parameters():
            value.zero_()
    cameras = front.camera(0)
    near = type(cameras)(cameras.K.clone(), cameras.viewmat, 24, 24)
    near.K[:2, :2] *= 8
    focal, depth = float(near.K[0, 0]), 4.0 - float(middle[2])
    near.K[1, 2] += focal * float(middle[1]) / depth
    still = torch.eye(4).expand(24, 4, 4)  # canonical as it is
    state = avatar.condition(still[:, :3, :3], 0, still, near.viewmat)
    seen = avatar.render(state, still[None], near)
    rows = torch.arange(24) + 0.5 - 12
    from_middle = torch.hypot(rows[:, None], rows) / (focal * radius / depth)
    assert torch.equal(seen.alpha[0] > 0.5, from_middle < 1)
    assert seen.alpha[0][from_middle < 0.8].min() > 0.99
    assert seen.alpha[0][from_middle > 1.2].max() < 0.01
    torch.testing.assert_close(seen.image, (seen.alpha / 2)[..., None].expand_as(seen.image))


def test_samples_that_are_left_out_hardly_show(avatar, bent, camera, monkeypatch):
    culled = drawn(avatar, bent, camera)
    monkeypatch.setattr("deblur_avatar.avatars.arah_small_avatar.CULL", -1.0)
    whole = drawn(avatar, bent, camera)
    assert (whole.image - culled.image).abs().max() < 5e-3
    assert not torch.equal(whole.image, culled.image)


def test_the_whole_body_and_the_camera_turned_together_make_the_same_picture(avatar, bent, camera):
    turn = axis_angle_to_matrix(torch.tensor([0.0, 1.2, 0.3]))
    moved = torch.eye(4)
    moved[:3, :3], moved[:3, 3] = turn, torch.tensor([0.5, -0.2, 1.0])
    along = type(camera)(camera.K, camera.viewmat @ invert_rigid(moved), 24, 24)
    state, transforms = state_of(avatar, bent)
    here = avatar.render(state, transforms[None], camera)
    there = avatar.render(state, (moved @ transforms)[None], along)
    apart = (here.image - there.image).abs()
    assert apart.mean() < 2e-3  # but where a search ends elsewhere
    aside = avatar.render(state, (moved @ transforms)[None], camera)
    assert (aside.image - here.image).abs().mean() > 1e-2


def test_a_mean_over_instants_is_the_mean_of_their_pictures(avatar, swinging, camera):
    rotations = axis_angle_to_matrix(swinging(2, 30.0).axis_angle)
    transforms = avatar.transforms(rotations, torch.zeros(2, 3))
    state = avatar.condition(rotations[1], 0, transforms[1], camera.viewmat)
    mean = avatar.render(state, transforms, camera, average=True)
    each = [avatar.render(state, one[None], camera) for one in transforms]
    torch.testing.assert_close(mean.image[0], torch.cat([one.image for one in each]).mean(0))
    torch.testing.assert_close(mean.alpha[0], torch.cat([one.alpha for one in each]).mean(0))


def test_nothing_in_sight_is_an_empty_picture_that_has_gradients(avatar, bent, camera, recipe):
    for step in (None, step_at(recipe, 5000)):
        avatar.zero_grad()
        seen = drawn(avatar, bent, camera, transl=(50.0, 0.0, 0.0), step=step)
        assert not seen.image.any()
        assert not seen.alpha.any()
        seen.image.sum().backward()


def test_every_unknown_gets_a_gradient_from_pictures(avatar, bent, camera, recipe):
    for step in (None, step_at(recipe, 5000)):
        avatar.zero_grad()
        drawn(avatar, bent, camera, step=step).image.square().sum().backward()
        for name, value in avatar.named_parameters():
            assert torch.isfinite(value.grad).all(), name
            assert value.grad.any(), name


def test_gradients_of_pose_and_translation_are_what_small_changes_do(avatar, bent):
    """Along rays whose samples stay where they are."""
    avatar = avatar.double()
    avatar.invalidate_neighbours()
    start = torch.cat([bent, torch.zeros(1, 3)]).double().requires_grad_()
    state, transforms = state_of(avatar, bent.double())
    skinning = ForwardSkinning(
        state.grid, transforms, avatar.canonical_vertices, avatar.lbs_weights
    )
    points = skinning.posed[::9].detach()

    def canonical(moved):
        skinning = ForwardSkinning(state.grid, moved, avatar.canonical_vertices, avatar.lbs_weights)
        found, sure = skinning.canonical(points, skinning.nearest(points)[1])
        for _ in range(3):  # to the last digit
            inverse, _ = skinning.inverse_jacobian(found)
            left = skinning.skinned(found) - points
            found = found - (inverse @ left[..., None])[..., 0]
        return skinning, found, sure

    def light(values, places=None):
        rotations = axis_angle_to_matrix(values[:-1])
        moved = avatar.transforms(rotations, values[-1])
        own = avatar.condition(rotations, 0, moved, torch.eye(4))
        if places is None:
            places = canonical(moved)[1]
        colors, densities = avatar.surface_colors(places, own)
        return colors.sum(1) + densities / 100

    from deblur_avatar.avatars.forward_skinning import attached

    skinning, found, sure = canonical(transforms)
    inverse, regular = skinning.inverse_jacobian(found)
    moved = avatar.transforms(axis_angle_to_matrix(start[:-1]), start[-1])
    # The grid's weights, whose roots these are.
    grid = state.grid
    places = 2 * (found - (grid.low + grid.high) / 2) / (grid.high - grid.low)
    weights = torch.nn.functional.grid_sample(
        grid.weights[None], places[None, :, None, None], align_corners=True
    )[0, :, :, 0, 0].T
    values = light(start, attached(found, inverse, weights, moved))
    usable = (sure & regular).nonzero()[:, 0]
    assert len(usable) > 15
    small, generator = 1e-6, seeded(3)
    way = torch.randn(start.shape, generator=generator, dtype=torch.double)
    with torch.no_grad():
        change = (light(start + small * way) - light(start - small * way)) / (2 * small)
    close = 0
    for row in usable.tolist():
        gradient = torch.autograd.grad(values[row], start, retain_graph=True)[0]
        close += float((gradient * way).sum()) == pytest.approx(
            float(change[row]), rel=0.05, abs=0.02
        )
    assert close > 0.85 * len(usable)


def test_pictures_move_pose_and_translation(avatar, bent, camera):
    start = torch.cat([bent, torch.zeros(1, 3)]).requires_grad_()
    rotations = axis_angle_to_matrix(start[:-1])
    transforms = avatar.transforms(rotations, start[-1])
    state = avatar.condition(rotations, 0, transforms, camera.viewmat)
    columns = torch.linspace(-1, 1, 24)
    seen = avatar.render(state, transforms[None], camera)
    (seen.alpha * columns).sum().backward()
    assert torch.isfinite(start.grad).all()
    # The camera looks along -z with x to the right: so does a body that moves to the right.
    assert start.grad[-1, 0] > 0


def test_every_regulariser_has_a_weight_and_pulls_at_what_it_is_named_after(
    avatar, bent, camera, recipe
):
    step = step_at(recipe, 1)
    rendering = drawn(avatar, bent, camera, step=step)
    terms = avatar.regularisers(rendering, step)
    assert terms.keys() == recipe.fitting.weights(step, 0.5).keys()
    pulled = {"eikonal": "sdf", "off_surface": "sdf", "inside": "sdf", "skinning": "skinning_field"}
    for name, term in terms.items():
        avatar.zero_grad()
        if name == "inside":  # of a body that is as it should be, nothing pulls
            with torch.no_grad():
                avatar.sdf.layers[-1].bias += 0.04
            term = avatar.regularisers(rendering, step)[name]
        value = term()
        assert torch.isfinite(value), name
        value.backward(retain_graph=True)
        moved = {
            n.partition(".")[0]
            for n, p in avatar.named_parameters()
            if p.grad is not None and p.grad.any()
        }
        assert pulled[name] in moved, name


def test_surfaces_far_from_the_body_and_air_deep_in_it_cost(
    avatar, bent, camera, recipe, monkeypatch
):
    step = step_at(recipe, 1)
    rendering = drawn(avatar, bent, camera, step=step)
    known = avatar._known_distances()
    assert (known.distances > 0.2).any()
    assert (known.distances < -0.03).any()

    def costs(field):
        def normals(points, modulation):
            true = signed_distances(points, avatar.canonical_vertices, avatar.faces)
            return field(true), points, torch.nn.functional.normalize(points)

        monkeypatch.setattr(avatar.sdf, "normals", normals)
        terms = avatar.regularisers(rendering, step_at(recipe, 1))
        return {name: terms[name]().item() for name in ("off_surface", "inside", "eikonal")}

    true = costs(lambda distances: distances)
    assert true["off_surface"] < 1e-6
    assert true["inside"] < 1e-6
    assert true["eikonal"] == pytest.approx(0.0, abs=1e-5)
    air, matter = costs(torch.abs), costs(lambda distances: -distances.abs())
    assert air["off_surface"] < 1e-6 < 1 < matter["off_surface"]
    assert matter["inside"] < 1e-6
    assert air["inside"] == pytest.approx(1.0)


def test_every_unknown_has_one_learning_rate_that_falls_to_a_tenth(avatar, recipe):
    rates = rates_of_all_unknowns(avatar, recipe)
    all_unknowns_are_in_networks(avatar)
    wanted = {"sdf": 5e-4, "color": 1e-3, "width": 1e-3, "latents": 1e-3, "skinning": 1e-4}
    for name, first in wanted.items():
        assert (rates[name].at(0.0), rates[name].at(1.0)) == pytest.approx((first, first / 10))
    decays = {name: rate.weight_decay for name, rate in rates.items() if rate.weight_decay}
    assert decays == {"latents": 0.05}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("sdf.hidden", []), ("sdf.width_m", 0.0), ("skinning.nodes", 1), ("color.hidden", []),
        ("samples.free", 0), ("precision", "half"),
    ],
)  # fmt: skip
def test_models_that_cannot_be_made_are_refused(content, path, value):
    model_is_refused(ArahSmallParams, content["model"], path, value)


def test_a_saved_avatar_is_drawn_as_it_was(avatar, body, swinging, camera, tmp_path):
    is_drawn_as_saved(avatar, body, swinging(2, 30.0), camera, tmp_path / "avatar")


def test_a_short_fit_explains_the_frames_better_and_again_the_same(observations, recipe, schedule):
    quick = changed(recipe, "fitting.rates", color=0.01)
    quick = changed(quick, "model.sdf", pretrain=60)
    found, terms = fitted_twice(observations, quick, schedule, 40)
    values = [one["l1"] for one in terms]
    assert sum(values[-8:]) < 0.9 * sum(values[:8])
    codes = found.networks["latents.codes"]
    assert codes[0].any()
    assert torch.equal(codes[-1], codes[-2])  # the last frame is not trained


def test_a_fit_that_was_stopped_ends_with_the_same_bytes(
    observations, recipe, schedule, monkeypatch, tmp_path
):
    recipe = changed(changed(recipe, "model.sdf", pretrain=20), "model.skinning", pretrain=20)
    stopped_ends_with_the_same_bytes(
        partial(fitted, observations, recipe, schedule, 10), monkeypatch, tmp_path / "warmup",
        refresh=4, stop_at=9, saved_at=7,
    )  # fmt: skip


def test_no_rig_carries_it_and_the_error_says_why(avatar, observations, motion):
    nothing_exports_it(avatar, "which is a volume", observations, motion)
