import dataclasses

import pytest
import torch

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.gart_avatar import GartAvatar, discs_on_surface
from deblur_avatar.avatars.gart_params import GartParams, HeldRate
from deblur_avatar.avatars.gaussians import Gaussians
from deblur_avatar.avatars.splats import SplatRendering
from deblur_avatar.bodies.posed_body import posed_vertices
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.posed_gaussians import posed_frame
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, quat_to_matrix
from deblur_avatar.geometry.skinning import invert_rigid
from deblur_avatar.motion.frame import FixedMotion, FixedParams
from deblur_avatar.rendering.covariances import whole_matrices
from deblur_avatar.training.optimizers import Optimizers
from deblur_avatar.training.params import FitParams, RecipeParams
from tests.avatars.avatar_checks import (
    fitted_twice,
    is_drawn_as_saved,
    model_is_refused,
    no_rig_carries_it,
    rates_of_all_unknowns,
)
from tests.changed_parameters import changed
from tests.randomness import seeded

pytestmark = pytest.mark.portable

CPU = torch.device("cpu")
FRAMES = 5
# Regularisers here are of the avatar alone.
UNSEEN = SplatRendering(
    torch.zeros(1, 2, 2, 3), torch.zeros(1, 2, 2), 1, None, torch.zeros(1, 1, 3),
    torch.zeros(1, 1, 6),
)  # fmt: skip


@pytest.fixture
def recipe(tiny_content):
    content = tiny_content["avatars"]["gart"]
    content["model"]["latent_bones"] = {"count": 2, "hidden": [8]}
    return parse(RecipeParams, content, "avatars.gart")


@pytest.fixture
def avatar(body, recipe):
    """Freshly made: corrections are 0, latent bones have their first small weight.

    Its body's root is not where space begins.
    """
    apart = torch.tensor([0.1, 0.2, -0.2])
    moved = dataclasses.replace(body, vertices=body.vertices + apart, joints=body.joints + apart)
    torch.manual_seed(0)
    betas = torch.tensor([0.3, 0.2])
    return GartAvatar.create(recipe.model, moved, betas, FRAMES, 120, "srgb", seeded())


@pytest.fixture
def unruly(avatar):
    """One whose weights sum to anything, with latent bones that move and colours of the view."""
    with torch.no_grad():
        avatar.weight_volume.corrections.normal_(std=0.05, generator=seeded(1))
        avatar.weight_volume.latent.normal_(std=0.1, generator=seeded(2))
        avatar.latent_bones.head.weight.normal_(std=0.3, generator=seeded(3))
        avatar.gaussians.features.normal_(generator=seeded(4))
    return avatar


@pytest.fixture
def seen(avatar, front):
    """Posed centres, covariances and colours in a pose that is turned about the root and moved."""

    def make(
        angles, turn=(0.0, 0.0, 0.0), transl=(0.0, 0.0, 0.0), viewmat=front.viewmats[0], step=None
    ):
        angles = torch.cat([torch.tensor([turn]), angles[1:]])
        rotations = axis_angle_to_matrix(angles)
        transforms = avatar.transforms(rotations, torch.tensor(transl))
        state = avatar.condition(rotations, 0, transforms, viewmat, step)
        means, covars = state.posed(transforms[None])
        return means[0], whole_matrices(covars[0]), state.colors

    return make


@pytest.fixture
def bent(body):
    return 0.25 * torch.randn(len(body.parents), 3, generator=seeded(7))  # radians


def bare(avatar):
    """Without latent bones, whose first weight is not quite 0."""
    with torch.no_grad():
        avatar.weight_volume.latent.zero_()
    return avatar


def step_at(recipe, iteration):
    return TrainingStep(iteration, 1.0, recipe.fitting, seeded())


def test_without_corrections_the_canonical_pose_leaves_every_gaussian_where_it_is(avatar, front):
    own = bare(avatar)
    still = torch.eye(4).expand(len(own.body.parents), 4, 4)
    rotations = still[:, :3, :3]
    state = own.condition(rotations, 0, still, front.viewmats[0])
    means, covars = state.posed(still[None])
    torch.testing.assert_close(means[0], own.gaussians.means, atol=1e-6, rtol=0)
    torch.testing.assert_close(covars[0], own.canonical_covariances(), atol=1e-7, rtol=1e-4)


def test_without_corrections_it_bends_as_the_body_does(avatar, bent):
    own, betas = bare(avatar), avatar.betas
    with torch.no_grad():
        count = len(own.canonical_vertices)
        own.gaussians = Gaussians(
            own.canonical_vertices.clone(), torch.tensor([1.0, 0, 0, 0]).repeat(count, 1),
            torch.full((count, 3), -4.0), torch.zeros(count), torch.zeros(count, 12),
        )  # fmt: skip
    transforms = own.transforms(axis_angle_to_matrix(bent), torch.tensor([1.0, 2.0, 3.0]))
    state = own.condition(axis_angle_to_matrix(bent), 0, transforms, torch.eye(4))
    means = state.posed(transforms[None])[0][0]
    wanted = posed_vertices(own.body, betas, bent[0], bent[1:], torch.tensor([1.0, 2.0, 3.0]))
    assert (means - wanted).norm(dim=1).median() < 0.01  # metres


def test_translation_moves_everything_by_itself_whatever_the_weights_sum_to(unruly, seen, bent):
    weights = unruly.weights_at(unruly.gaussians.means)
    assert (weights[:, :-1].sum(1) - 1).abs().max() > 0.2
    assert torch.equal(weights[:, -1], torch.ones(len(weights)))
    here, shape, _ = seen(bent)
    there, other, _ = seen(bent, transl=(1.0, -2.0, 3.0))
    torch.testing.assert_close(there - here, torch.tensor([[1.0, -2.0, 3.0]]).expand_as(here))
    torch.testing.assert_close(shape, other, atol=1e-6, rtol=1e-4)


def test_the_whole_body_turns_about_its_root_latent_bones_and_all(unruly, seen, bent):
    angles = (0.2, 1.0, -0.3)
    turn = axis_angle_to_matrix(torch.tensor(angles))
    means, covars, _ = seen(bent)
    turned, other, _ = seen(bent, angles)
    # With weights that sum to s the root joint is taken to s times its place: turn what is left.
    weights = unruly.weights_at(unruly.gaussians.means)[:, :-1].sum(1, keepdim=True)
    pivot = weights * unruly.root
    torch.testing.assert_close(turned, (means - pivot) @ turn.T + pivot, atol=1e-5, rtol=0)
    torch.testing.assert_close(other, turn @ covars @ turn.T, atol=1e-6, rtol=1e-4)


def test_colours_turn_with_the_body(avatar, seen, bent, front):
    with torch.no_grad():
        bare(avatar).gaussians.features.normal_(generator=seeded(4))
    viewmat = front.viewmats[0]
    angles, shift = (0.0, 1.2, 0.0), (0.5, 0.0, -0.5)
    here, there = seen(bent)[2], seen(bent, angles, shift)[2]
    assert (here - there).abs().max() > 0.01
    # The camera goes round with it: what it sees is the same.
    turn, root = axis_angle_to_matrix(torch.tensor(angles)), avatar.root
    moved = torch.eye(4)
    moved[:3, :3], moved[:3, 3] = turn, root - turn @ root + torch.tensor(shift)
    along = seen(bent, angles, shift, viewmat @ invert_rigid(moved))[2]
    torch.testing.assert_close(along, here, atol=1e-5, rtol=0)


def test_a_gaussians_own_frame_is_what_its_colours_turn_with(avatar, front):
    own = bare(avatar)
    with torch.no_grad():
        own.gaussians.features.normal_(generator=seeded(4))
    still = torch.eye(4).expand(len(own.body.parents), 4, 4)

    def colors():
        return own.condition(still[:, :3, :3], 0, still, front.viewmats[0]).colors

    before = colors()
    with torch.no_grad():
        own.gaussians.quats.copy_(torch.randn(len(before), 4, generator=seeded(5)))
    assert not torch.allclose(colors(), before)


def test_latent_bones_wait_but_their_weights_do_not(avatar, seen, bent, recipe):
    start = recipe.fitting.latent_bones.start
    for iteration in (start, start + 1):
        avatar.zero_grad()
        seen(bent, step=step_at(recipe, iteration))[0].square().sum().backward()
        head = avatar.latent_bones.head.weight.grad
        assert (head is None) == (iteration == start)
        assert avatar.weight_volume.latent.grad.abs().sum() > 0
        assert avatar.weight_volume.corrections.grad.abs().sum() > 0


def test_it_starts_with_one_colour_from_all_sides(unruly, seen, bent, recipe):
    (up,) = recipe.fitting.harmonics_up_at
    constant = (0.5 + 0.28209479 * unruly.gaussians.features[:, :3]).clamp(min=0)
    torch.testing.assert_close(seen(bent, step=step_at(recipe, up))[2], constant)
    after = seen(bent, step=step_at(recipe, up + 1))[2]
    assert not torch.allclose(after, constant)
    assert torch.equal(after, seen(bent)[2])  # and is so ever after


def test_gaussians_start_as_discs_that_cover_the_surface(body, avatar):
    vertices = avatar.canonical_vertices
    discs = discs_on_surface(vertices, body.faces, 500, 12, seeded())
    corners = vertices[body.faces]
    edges = corners[:, 1:] - corners[:, :1]
    area = torch.linalg.cross(edges[:, 0], edges[:, 1]).norm(dim=1).sum() / 2
    radius, again, thickness = discs.scales.unbind(1)
    torch.testing.assert_close(radius, again)
    torch.testing.assert_close(thickness, radius / 2)
    torch.testing.assert_close(500 * torch.pi * radius[0] ** 2, area)
    torch.testing.assert_close(discs.opacities, torch.full((500,), 0.99))
    assert torch.equal(discs.features, torch.zeros(500, 12))


def test_discs_of_a_plane_lie_in_it_turned_at_random():
    square = torch.tensor([[0.0, 0, 0], [1.0, 0, 0], [1.0, 1, 0], [0.0, 1, 0]])
    discs = discs_on_surface(square, torch.tensor([[0, 1, 2], [0, 2, 3]]), 50, 3, seeded())
    frames = quat_to_matrix(discs.quats)
    torch.testing.assert_close(torch.linalg.det(frames), torch.ones(50))
    torch.testing.assert_close(frames[:, :, 2], torch.tensor([0.0, 0, 1]).expand(50, 3))
    assert frames[:, :2, 0].std(0).min() > 0.3
    assert torch.equal(discs.quats, discs_on_surface(
        square, torch.tensor([[0, 1, 2], [0, 2, 3]]), 50, 3, seeded()
    ).quats)  # fmt: skip


def test_a_neighbourhood_is_six_gaussians_until_they_have_moved(avatar):
    before = avatar.neighbours()
    assert before.shape == (120, 5)
    assert avatar.neighbours() is before
    avatar.invalidate_neighbours()
    assert avatar.neighbours() is not before


def test_every_regulariser_has_a_weight_and_pulls_at_what_it_is_named_after(unruly, recipe):
    step = step_at(recipe, 1)
    terms = unruly.regularisers(UNSEEN, step)
    assert terms.keys() == recipe.fitting.weights(step, 0.5).keys()
    pulled = {
        "std_quats": "gaussians.quats", "std_scales": "gaussians.log_scales",
        "std_opacities": "gaussians.opacity_logits", "std_colors": "gaussians.features",
        "std_harmonics": "gaussians.features", "size_scales": "gaussians.log_scales",
        "tv_weights": "weight_volume.corrections", "size_weights": "weight_volume.corrections",
        "tv_latent": "weight_volume.latent", "size_latent": "weight_volume.latent",
    }  # fmt: skip
    with torch.no_grad():
        for name in ("log_scales", "opacity_logits"):
            getattr(unruly.gaussians, name).add_(
                0.1 * torch.randn(getattr(unruly.gaussians, name).shape, generator=seeded(5))
            )
    for name, term in terms.items():
        unruly.zero_grad()
        term().backward()
        moved = {n for n, p in unruly.named_parameters() if p.grad is not None and p.grad.any()}
        assert moved == {pulled[name]}, name
    unruly.zero_grad()
    terms["std_colors"]().backward()
    assert not unruly.gaussians.features.grad[:, 3:].any()
    unruly.zero_grad()
    terms["std_harmonics"]().backward()
    assert not unruly.gaussians.features.grad[:, :3].any()


def test_the_size_of_scales_is_that_of_the_longest(avatar, recipe):
    longest = avatar.gaussians.scales.amax(1)
    term = avatar.regularisers(UNSEEN, step_at(recipe, 1))["size_scales"]
    torch.testing.assert_close(term(), longest.square().mean())


def test_every_unknown_has_one_learning_rate(avatar, recipe):
    rates_of_all_unknowns(avatar, recipe)


def test_rates_of_the_volume_hold_and_then_fall():
    rate = HeldRate(1e-4, 0.1, held=0.5)
    shares = (0.0, 0.25, 0.5, 0.75, 1.0)
    wanted = [1e-4, 1e-4, 1e-4, 1e-4 * 0.1**0.5, 1e-5]
    assert [rate.at(share) for share in shares] == pytest.approx(wanted)


def test_learning_rates_are_those_of_the_release(recipe):
    rates = recipe.fitting.learning_rates(recipe.final_share)
    ends = {name: (rate.at(0.0), rate.at(1.0)) for name, rate in rates.items()}
    wanted = {
        "means": (1.6e-4, 1.6e-6), "quats": (5e-3, 5e-3), "scales": (5e-3, 5e-3),
        "opacities": (0.05, 0.05), "features": (5e-3, 5e-3), "corrections": (1e-4, 1e-5),
        "latent": (3e-5, 3e-6), "bones": (3e-5, 3e-5),
    }  # fmt: skip
    assert ends.keys() == wanted.keys()
    for name, pair in wanted.items():
        assert ends[name] == pytest.approx(pair), name


def test_degrees_of_harmonics_are_as_many_as_when_they_count(tiny_content):
    content = tiny_content["avatars"]["gart"]
    content["fitting"]["harmonics_up_at"] = []
    with pytest.raises(ConfigError, match="harmonics_up_at must name 1 iterations.* got 0"):
        parse(RecipeParams, content, "avatars.gart")


@pytest.mark.parametrize(
    ("path", "value"),
    [("volume.nodes", [2, 8, 8]), ("volume.smoothing", -1), ("harmonics", 4)],
)
def test_models_that_cannot_be_made_are_refused(tiny_content, path, value):
    model_is_refused(GartParams, tiny_content["avatars"]["gart"]["model"], path, value)


def test_a_saved_avatar_is_drawn_as_it_was(unruly, swinging, front, tmp_path):
    is_drawn_as_saved(unruly, unruly.body, swinging(2, 30.0), front.camera(0), tmp_path / "avatar")


def test_a_mean_over_instants_is_the_mean_of_their_pictures(unruly, swinging, front):
    rotations = axis_angle_to_matrix(swinging(3, 20.0).axis_angle)
    transforms = unruly.transforms(rotations, torch.zeros(3, 3))
    state = unruly.condition(rotations[1], 0, transforms[1], front.viewmats[0])
    mean = unruly.render(state, transforms, front.camera(0), average=True)
    each = [unruly.render(state, one[None], front.camera(0)).image for one in transforms]
    torch.testing.assert_close(mean.image[0], torch.cat(each).mean(0), atol=1e-5, rtol=0)


def test_a_short_fit_explains_the_frames_better(observations, recipe, schedule):
    quick = changed(recipe, "fitting.densify", max_growth=3.0)
    found, terms = fitted_twice(observations, quick, schedule, 60)
    assert found.networks["weight_volume.corrections"].any()
    pictures = [one["l1"] + one["dissimilarity"] + one["mask"] for one in terms]
    assert sum(pictures[-10:]) < 0.7 * sum(pictures[:10])


def test_its_gaussians_alone_are_densified(avatar, recipe, schedule, observations):
    params = FitParams(recipe=recipe, motion=FixedParams(kind="fixed"), schedule=schedule)
    optimizers = Optimizers(avatar, FixedMotion(observations.poses), None, params)
    names = {name for group in optimizers.gaussians.param_groups for name in group["names"]}
    assert names == {"means", "quats", "log_scales", "opacity_logits", "features"}


def test_no_rig_carries_it_and_the_error_says_why(unruly, observations, motion):
    why = "whose weights do not sum to 1.* latent"
    run = no_rig_carries_it(unruly, why, observations, motion)
    assert len(posed_frame(run, 0).means) == 120
