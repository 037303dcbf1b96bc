from functools import partial

import pytest
import torch

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.frequency_encoding import frequency_encoding, hann_window
from deblur_avatar.avatars.humannerf_small_avatar import HumannerfSmallAvatar
from deblur_avatar.avatars.humannerf_small_params import HumannerfSmallParams
from deblur_avatar.bodies.posed_body import posed_joints
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import invert_rigid
from deblur_avatar.training.params import RecipeParams
from tests.avatars.avatar_checks import (
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


@pytest.fixture
def content(tiny_content):
    content = tiny_content["avatars"]["humannerf_small"]
    content["model"] |= {
        "precision": "float32",
        "samples": 12,
        "field": {"frequencies": 4, "hidden": [16, 16]},
        "motion_weights": {"margin_m": 0.3, "code": 8, "dense": 8, "channels": [8, 8, 8]},
        "nonrigid": {"frequencies": 3, "hidden": [8, 8]},
    }
    content["fitting"]["rays"] = {"patches": 2, "size": 8, "on_person": 0.8, "coarse": 4}
    return content


@pytest.fixture
def recipe(content):
    return parse(RecipeParams, content, "avatars.humannerf_small")


@pytest.fixture
def avatar(body, recipe):
    """Freshly made."""
    betas = torch.tensor([0.3, 0.2])
    return HumannerfSmallAvatar.create(recipe.model, body, betas, FRAMES, 1, "srgb", seeded())


@pytest.fixture
def loud(avatar):
    """One whose offsets say something, and whose body is dense."""
    with torch.no_grad():
        avatar.offsets.last.weight.normal_(std=0.02, generator=seeded(1))
        avatar.field.last.bias[3] = 3.0
    return avatar


@pytest.fixture
def bent(body):
    return 0.25 * torch.randn(len(body.parents), 3, generator=seeded(7))  # radians


@pytest.fixture
def camera(front):
    return front.camera(0)


def step_at(recipe, iteration, scale=1.0):
    return TrainingStep(iteration, scale, recipe.fitting, seeded())


def test_its_parts_are_as_large_as_said(tiny_content, body):
    content = tiny_content["avatars"]["humannerf_small"]
    recipe = parse(RecipeParams, content, "avatars.humannerf_small")
    avatar = HumannerfSmallAvatar.create(recipe.model, body, torch.zeros(2), 1, 1, "srgb", seeded())
    assert [layer.in_features for layer in avatar.field.layers] == [63, 128, 128, 128]
    assert [layer.in_features for layer in avatar.offsets.layers] == [36 + 69, 64, 64]
    assert avatar.motion_weights().shape == (24, 32, 32, 32)
    numbers = sum(value.numel() for value in avatar.motion_weights.parameters())
    assert 0.4e6 < numbers < 1.1e6


def test_all_that_is_random_of_it_comes_from_the_generator(body, recipe, avatar):
    torch.manual_seed(99)
    again = HumannerfSmallAvatar.create(recipe.model, body, avatar.betas, 5, 1, "srgb", seeded())
    for one, other in zip(avatar.parameters(), again.parameters(), strict=True):
        assert torch.equal(one, other)


def test_it_has_no_gaussians(avatar):
    assert avatar.densified is None
    assert len(avatar.to_artifact(1).means) == 0


def test_it_begins_as_fog_where_the_body_is(avatar, bent, camera):
    seen = drawn(avatar, bent, camera)
    body = avatar.body_pixels(state_of(avatar, bent)[1], camera)
    assert 0.1 < seen.alpha[0][body].mean() < 0.9
    assert seen.alpha[0][0, :6].max() < 1e-3


def test_the_body_is_looked_for_where_its_vertices_are_seen(avatar, bent, camera):
    shown = avatar.body_pixels(state_of(avatar, bent)[1], camera)
    assert 20 < shown.sum() < 300
    away = state_of(avatar, bent, transl=(50.0, 0.0, 0.0))[1]
    assert not avatar.body_pixels(away, camera).any()
    behind = state_of(avatar, bent, transl=(0.0, 0.0, 9.0))[1]
    assert not avatar.body_pixels(behind, camera).any()


def test_the_box_holds_the_posed_joints_with_a_margin(avatar, body, bent):
    bent = bent.clone()
    bent[0] = 0
    transforms = state_of(avatar, bent)[1]
    low, high = avatar.bounds(transforms)
    joints = posed_joints(body, avatar.betas, bent[0], bent[1:], torch.zeros(3))
    torch.testing.assert_close(low, joints.amin(0) - 0.3, atol=1e-5, rtol=0)
    torch.testing.assert_close(high, joints.amax(0) + 0.3, atol=1e-5, rtol=0)


def test_points_of_the_body_at_rest_stay_where_they_are(avatar, body, camera, monkeypatch):
    asked = []
    own = avatar.radiance
    monkeypatch.setattr(avatar, "radiance", lambda places: asked.append(places) or own(places))
    state, transforms = state_of(avatar, torch.zeros(24, 3))
    rays, met = avatar.rays(transforms, camera, torch.tensor([[12, 11]]))
    assert met.all()
    with torch.no_grad():
        avatar.offsets.last.weight.zero_()
    avatar.march(state, transforms, rays, None)
    steps = (asked[0] - rays.origins) @ rays.directions[0]
    line = rays.origins + steps[:, None] * rays.directions
    assert len(asked[0]) > 3
    torch.testing.assert_close(asked[0], line, atol=1e-4, rtol=0)


def test_a_denser_field_covers_more_and_by_the_share_that_is_not_air(loud, bent, camera):
    before = drawn(loud, bent, camera).alpha
    with torch.no_grad():
        loud.field.last.bias[3] = 50.0  # opaque: what is left to let through is air
    after = drawn(loud, bent, camera).alpha
    assert (after >= before - 1e-5).all()
    state, transforms = state_of(loud, bent)
    rays, _ = loud.rays(transforms, camera, torch.tensor([[12, 11]]))
    depths = rays.near[:, None] + (rays.far - rays.near)[:, None] * (torch.arange(12) + 0.5) / 12
    back = loud.rest_from_canonical @ invert_rigid(transforms)
    shares = loud.motion_weights.weights_at(state.weights, rays.at(depths)[0], back).sum(0)
    shares = torch.where(shares > 1e-3, shares, torch.zeros_like(shares))
    wanted = 1 - (1 - shares).prod()
    assert loud.march(state, transforms, rays, None)[1][0].item() == pytest.approx(
        wanted.item(), abs=1e-4
    )


def test_no_point_keeps_back_more_than_all_light(loud, bent, camera):
    with torch.no_grad():
        loud.field.last.bias[3] = 50.0
        loud.motion_weights.doublings[-1].bias[:-1] = 6.0  # hardly any air
    seen = drawn(loud, 3 * bent, camera)
    assert 0.99 < seen.alpha.max() <= 1 + 1e-6
    assert seen.alpha.min() >= 0


def test_what_is_left_out_for_being_air_hardly_shows(loud, bent, camera, monkeypatch):
    culled = drawn(loud, bent, camera)
    monkeypatch.setattr("deblur_avatar.avatars.humannerf_small_avatar.CULL", 0.0)
    whole = drawn(loud, bent, camera)
    assert (whole.image - culled.image).abs().max() < 5e-3
    assert not torch.equal(whole.image, culled.image)


def test_the_whole_body_and_the_camera_turned_together_make_the_same_picture(loud, bent, camera):
    turn = axis_angle_to_matrix(torch.tensor([0.0, 1.2, 0.3]))
    moved = torch.eye(4)
    moved[:3, :3], moved[:3, 3] = turn, torch.tensor([0.5, -0.2, 1.0])
    along = type(camera)(camera.K, camera.viewmat @ invert_rigid(moved), 24, 24)
    state, transforms = state_of(loud, bent)
    here = loud.render(state, transforms[None], camera)
    there = loud.render(state, (moved @ transforms)[None], along)
    torch.testing.assert_close(here.image, there.image, atol=2e-3, rtol=0)
    aside = loud.render(state, (moved @ transforms)[None], camera)
    assert (aside.image - here.image).abs().mean() > 1e-2


def offset_at(avatar, angles, step=None):
    places = avatar.joints + 0.02
    state, _ = state_of(avatar, angles, step=step)
    return (avatar.moved(places, state) - places).detach()


@pytest.mark.parametrize("scale", [1.0, 0.2])
def test_offsets_wait_and_then_see_one_frequency_after_the_other(loud, bent, recipe, scale):
    fitting = recipe.fitting.nonrigid
    assert not offset_at(loud, bent, step_at(recipe, round(fitting.start * scale), scale)).any()
    places, pose = loud.joints + 0.02, bent[1:].flatten() + 1e-2
    halfway = (fitting.start + fitting.full) / 2
    for iteration, share in ((halfway, 0.5), (fitting.full, 1.0), (2 * fitting.full, 1.0)):
        encoded = frequency_encoding(places, 3, hann_window(share, 3))
        found = offset_at(loud, bent, step_at(recipe, round(iteration * scale), scale))
        torch.testing.assert_close(found, loud.offsets(encoded, pose), atol=1e-5, rtol=0)
    torch.testing.assert_close(found, offset_at(loud, bent), atol=1e-6, rtol=0)


def test_offsets_see_the_pose_but_not_how_the_body_is_turned(loud, bent):
    turned, other = bent.clone(), bent.clone()
    turned[0] = torch.tensor([0.0, 2.0, 0.0])
    other[7] = turned[0]
    assert torch.equal(offset_at(loud, bent), offset_at(loud, turned))
    assert not torch.allclose(offset_at(loud, bent), offset_at(loud, other), atol=1e-4)


def test_a_mean_over_instants_is_the_mean_of_their_pictures(loud, swinging, camera):
    rotations = axis_angle_to_matrix(swinging(3, 40.0).axis_angle)
    transforms = loud.transforms(rotations, torch.zeros(3, 3))
    state = loud.condition(rotations[1], 0, transforms[1], camera.viewmat)
    mean = loud.render(state, transforms, camera, average=True)
    each = [loud.render(state, one[None], camera) for one in transforms]
    torch.testing.assert_close(mean.image[0], torch.cat([one.image for one in each]).mean(0))
    torch.testing.assert_close(mean.alpha[0], torch.cat([one.alpha for one in each]).mean(0))
    assert mean.instants == 3
    assert len(loud.render(state, transforms, camera).image) == 3


def test_the_background_is_what_coverage_lets_through_of_it(loud, bent, camera):
    behind = torch.tensor([0.2, 0.5, 0.9])
    black = drawn(loud, bent, camera)
    over = drawn(loud, bent, camera, background=behind)
    torch.testing.assert_close(over.image, black.image + (1 - black.alpha)[..., None] * behind)


def test_nothing_in_sight_is_an_empty_picture_that_has_gradients(loud, bent, camera, recipe):
    for step in (None, step_at(recipe, 5000)):
        seen = drawn(loud, bent, camera, transl=(50.0, 0.0, 0.0), step=step)
        assert not seen.image.any()
        assert not seen.alpha.any()
        loud.zero_grad()
        seen.image.sum().backward()
        assert not loud.field.last.weight.grad.any()


def test_large_pictures_are_drawn_in_parts(loud, bent, camera, monkeypatch):
    whole = drawn(loud, bent, camera)
    monkeypatch.setattr("deblur_avatar.avatars.volumes.RAYS_AT_ONCE", 100)
    torch.testing.assert_close(drawn(loud, bent, camera).image, whole.image, atol=1e-5, rtol=0)


def test_a_step_of_fitting_has_gradients_in_patches_and_a_coarse_picture_around(
    loud, bent, camera, recipe
):
    seen = drawn(loud, bent, camera, step=step_at(recipe, 5000))
    whole = drawn(loud, bent, camera)
    assert (seen.alpha - whole.alpha).abs().mean() < 0.05
    seen.alpha.retain_grad()
    gradient = torch.autograd.grad(seen.alpha.sum(), [loud.field.last.weight])[0]
    assert gradient.any()


def test_patches_as_large_as_the_picture_are_the_picture_and_its_gradient(
    loud, bent, camera, recipe, monkeypatch
):
    monkeypatch.setattr(
        "deblur_avatar.avatars.humannerf_small_avatar.sample_depths", _middles
    )  # drawn depths would differ
    whole_rays = changed(recipe, "fitting.rays", size=24, patches=1)
    found = []
    for step in (None, step_at(whole_rays, 10_000)):
        seen = drawn(loud, bent, camera, step=step)
        loss = (seen.image - 0.3).abs().mean()
        found.append(torch.autograd.grad(loss, [loud.field.last.weight])[0])
    torch.testing.assert_close(found[0], found[1], atol=1e-6, rtol=1e-4)


def _middles(near, far, count, generator=None):
    return near[:, None] + (far - near)[:, None] * (torch.arange(count) + 0.5) / count


def test_gradients_of_patches_are_on_average_those_of_the_whole_picture(
    loud, bent, camera, recipe, monkeypatch
):
    monkeypatch.setattr("deblur_avatar.avatars.humannerf_small_avatar.sample_depths", _middles)
    bias, rays = loud.field.last.bias, changed(recipe, "fitting.rays", size=6).fitting
    # Patches are as likely everywhere.
    monkeypatch.setattr(
        "deblur_avatar.avatars.volumes.patch_middles",
        lambda likely, *_: torch.full(likely.shape, 1 / likely.numel()),
    )

    inner = torch.zeros(24, 24, 1)
    inner[6:-6, 6:-6] = 1  # near the edges fewer patches lie

    def gradient(step):
        seen = drawn(loud, bent, camera, step=step)
        return torch.autograd.grad((inner * seen.image.square()).sum(), [bias])[0]

    generator, total = seeded(), torch.zeros(4)
    for _ in range(150):
        total += gradient(TrainingStep(10_000, 1.0, rays, generator))
    torch.testing.assert_close(total / 150, gradient(None), rtol=0.25, atol=0)


def test_the_instants_of_an_exposure_and_its_middle_are_drawn_at_the_same_pixels(
    loud, swinging, camera, recipe, monkeypatch
):
    seen = []
    own = loud.rays
    monkeypatch.setattr(
        loud, "rays", lambda transforms, *rest: seen.append(rest[1]) or own(transforms, *rest)
    )
    rotations = axis_angle_to_matrix(swinging(3, 10.0).axis_angle)
    transforms = loud.transforms(rotations, torch.zeros(3, 3))
    state = loud.condition(rotations[1], 0, transforms[1], camera.viewmat, step_at(recipe, 9000))
    mean, middle = loud.render_exposure(state, transforms, camera, average=True)
    assert mean.image.shape == middle.image.shape == (1, 24, 24, 3)
    assert (mean.instants, middle.instants) == (2, 1)
    patches = [pixels for pixels in seen if len(pixels) not in (24 * 24, 6 * 6)]
    assert len(patches) == 3
    assert torch.equal(patches[0], patches[1])
    assert torch.equal(patches[0], patches[2])


def test_every_unknown_gets_a_gradient_from_pictures(loud, bent, camera, recipe):
    for step in (None, step_at(recipe, 5000)):
        loud.zero_grad()
        drawn(loud, bent, camera, step=step).image.square().sum().backward()
        for name, value in loud.named_parameters():
            assert torch.isfinite(value.grad).all(), name
            assert value.grad.any(), name


def test_gradients_of_pose_and_translation_are_what_small_changes_do(loud, bent, camera):
    loud, exact = loud.double(), type(camera)(camera.K.double(), camera.viewmat.double(), 24, 24)
    start = torch.cat([bent, torch.zeros(1, 3)]).double().requires_grad_()
    state, transforms = state_of(loud, bent.double())
    rays, met = loud.rays(transforms, exact, torch.tensor([[12, 11], [14, 9], [10, 14]]))
    assert met.all()

    def light(values):
        rotations = axis_angle_to_matrix(values[:-1])
        moved = loud.transforms(rotations, values[-1])
        # Rays and their samples stay where they are: no gradient flows through those.
        state = loud.condition(rotations, 0, moved, exact.viewmat)
        image, alpha = loud.march(state, moved, rays, None)
        return (image.sum(1) + alpha).sum()

    gradient = torch.autograd.grad(light(start), start)[0]
    generator, small = seeded(3), 1e-6
    for _ in range(4):
        way = torch.randn(start.shape, generator=generator, dtype=torch.double)
        with torch.no_grad():
            change = light(start + small * way) - light(start - small * way)
        assert float(change / (2 * small)) == pytest.approx(
            float((gradient * way).sum()), rel=2e-3, abs=1e-6
        )
    assert gradient[-1].any()


def test_every_unknown_has_one_learning_rate_that_falls_to_a_tenth(avatar, recipe):
    rates = rates_of_all_unknowns(avatar, recipe)
    all_unknowns_are_in_networks(avatar)
    ends = {name: (rate.at(0.0), rate.at(1.0)) for name, rate in rates.items()}
    wanted = {"field": 2e-3, "motion_weights": 5e-4, "nonrigid": 5e-4}
    for name, first in wanted.items():
        assert ends[name] == pytest.approx((first, first / 10)), name


@pytest.mark.parametrize(
    ("path", "value"),
    [("samples", 1), ("field.hidden", []), ("nonrigid.frequencies", 0), ("precision", "half")],
)
def test_models_that_cannot_be_made_are_refused(content, path, value):
    model_is_refused(HumannerfSmallParams, content["model"], path, value)


def test_a_window_that_closes_before_it_opens_is_refused(content):
    content["fitting"]["nonrigid"]["full"] = content["fitting"]["nonrigid"]["start"]
    with pytest.raises(ConfigError, match="full must be after start = 375, got 375"):
        parse(RecipeParams, content, "avatars.humannerf_small")


def test_a_saved_avatar_is_drawn_as_it_was(loud, body, swinging, camera, tmp_path):
    is_drawn_as_saved(loud, body, swinging(2, 30.0), camera, tmp_path / "avatar")


def test_a_short_fit_explains_the_frames_better_and_again_the_same(observations, recipe, schedule):
    quick = changed(recipe, "fitting.rates", field=0.01, motion_weights=5e-3)
    _, terms = fitted_twice(observations, quick, schedule, 60)
    for name, share in {"l1": 0.75, "mask": 0.75}.items():
        values = [one[name] for one in terms]
        assert sum(values[-10:]) < share * sum(values[:10]), name


def test_a_fit_that_was_stopped_ends_with_the_same_bytes(
    observations, recipe, schedule, monkeypatch, tmp_path
):
    stopped_ends_with_the_same_bytes(
        partial(fitted, observations, recipe, schedule, 10), monkeypatch, tmp_path / "warmup",
        refresh=4, stop_at=9, saved_at=7,
    )  # fmt: skip


def test_no_rig_carries_it_and_the_error_says_why(avatar, observations, motion):
    nothing_exports_it(avatar, "which is a volume", observations, motion)
