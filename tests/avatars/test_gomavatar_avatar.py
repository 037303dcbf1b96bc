from functools import partial

import pytest
import torch

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.frequency_encoding import frequency_encoding, hann_window
from deblur_avatar.avatars.gomavatar_avatar import GomavatarAvatar
from deblur_avatar.avatars.gomavatar_params import GomavatarParams
from deblur_avatar.avatars.mesh_gaussians import face_gaussians
from deblur_avatar.avatars.mesh_terms import laplacian, mesh_edges
from deblur_avatar.avatars.surface_projection import vertex_normals
from deblur_avatar.bodies.posed_body import posed_vertices
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.cameras import Camera
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.motion.frame import FixedMotion, FixedParams
from deblur_avatar.rendering.conventions import eps2d_of
from deblur_avatar.rendering.mesh_rendering import View, cast_rays
from deblur_avatar.rendering.rasterize import rasterize
from deblur_avatar.training.optimizers import Optimizers
from deblur_avatar.training.params import FitParams, RecipeParams
from tests.avatars.avatar_checks import (
    all_unknowns_are_in_networks,
    fitted,
    fitted_twice,
    is_drawn_as_saved,
    model_is_refused,
    nothing_exports_it,
    rates_of_all_unknowns,
    stopped_ends_with_the_same_bytes,
)
from tests.changed_parameters import changed
from tests.randomness import seeded

pytestmark = pytest.mark.portable

CPU = torch.device("cpu")
FRAMES = 5


@pytest.fixture
def content(tiny_content):
    content = tiny_content["avatars"]["gomavatar"]
    content["model"]["shading"] = {"frequencies": 2, "hidden": [8]}
    content["model"]["nonrigid"] = {"frequencies": 3, "hidden": [8, 8, 8, 8, 8, 8]}
    return content


@pytest.fixture
def recipe(content):
    return parse(RecipeParams, content, "avatars.gomavatar")


@pytest.fixture
def avatar(body, recipe):
    """Freshly made."""
    betas = torch.tensor([0.3, 0.2])
    return GomavatarAvatar.create(recipe.model, body, betas, FRAMES, 120, "srgb", seeded())


@pytest.fixture
def loud(avatar):
    """One whose networks say something, with Gaussians of all shapes and colours."""
    with torch.no_grad():
        for index, network in enumerate((avatar.shading, avatar.offsets)):
            network.last.weight.normal_(std=0.3, generator=seeded(index))
        avatar.offsets.last.weight.mul_(0.05)
        avatar.mesh.turns.normal_(generator=seeded(2))
        avatar.mesh.scales.add_(0.3 * torch.randn(len(avatar.faces), 3, generator=seeded(3)))
        avatar.mesh.colors.uniform_(generator=seeded(4))
    return avatar


@pytest.fixture
def bent(body):
    return 0.25 * torch.randn(len(body.parents), 3, generator=seeded(7))  # radians


@pytest.fixture
def camera(front):
    return front.camera(0)


def drawn(avatar, angles, camera, transl=(0.0, 0.0, 0.0), step=None, **options):
    rotations = axis_angle_to_matrix(angles)
    transforms = avatar.transforms(rotations, torch.tensor(transl))
    state = avatar.condition(rotations, 0, transforms, camera.viewmat, step)
    return avatar.render(state, transforms[None], camera, **options)


def silent(avatar):
    """Without what networks say at the very start, which is not quite nothing."""
    with torch.no_grad():
        for network in (avatar.shading, avatar.offsets):
            network.last.weight.zero_()
    return avatar


def step_at(recipe, iteration, scale=1.0):
    return TrainingStep(iteration, scale, recipe.fitting, seeded())


def test_it_has_a_gaussian_a_face_however_many_are_asked_for(avatar, body):
    assert len(avatar.mesh.colors) == len(body.faces)
    assert len(avatar.mesh.vertices) == len(body.vertices)
    assert avatar.densified is None


def test_all_that_is_random_of_it_comes_from_the_generator(body, recipe, avatar):
    torch.manual_seed(99)
    again = GomavatarAvatar.create(recipe.model, body, avatar.betas, FRAMES, 120, "srgb", seeded())
    for one, other in zip(avatar.parameters(), again.parameters(), strict=True):
        assert torch.equal(one, other)


def test_its_networks_are_as_large_as_the_published_ones(tiny_content, body):
    content = tiny_content["avatars"]["gomavatar"]
    recipe = parse(RecipeParams, content, "avatars.gomavatar")
    avatar = GomavatarAvatar.create(recipe.model, body, torch.zeros(2), FRAMES, 1, "srgb", seeded())
    assert sum(value.numel() for value in avatar.shading.parameters()) == 38_273
    wide = [layer.in_features for layer in avatar.offsets.layers]
    assert wide == [36 + 69, 128, 128, 128, 128 + 36, 128]


def test_without_offsets_its_vertices_are_the_bodys(avatar, body, bent, camera):
    shift = torch.tensor([1.0, 2.0, 3.0])
    posed = drawn(silent(avatar), bent, camera, shift.tolist()).vertices[0]
    apart = (posed - posed_vertices(body, avatar.betas, bent[0], bent[1:], shift)).norm(dim=1)
    # But where weights are blended twice: into the canonical pose and out of it.
    blended = body.lbs_weights.amax(1) < 0.999
    assert apart[~blended].max() < 1e-5
    assert apart.max() < 0.03


def test_it_starts_next_to_unshaded_and_where_the_body_is(avatar, bent, camera):
    before = drawn(avatar, bent, camera)
    after = drawn(silent(avatar), bent, camera)
    torch.testing.assert_close(before.image, after.image, atol=1e-3, rtol=0)
    torch.testing.assert_close(before.vertices, after.vertices, atol=1e-3, rtol=0)
    torch.testing.assert_close(avatar.shades(torch.randn(9, 3)), torch.ones(9))


def test_it_starts_as_grey_as_it_covers(avatar, bent, camera):
    seen = drawn(silent(avatar), bent, camera)
    assert seen.alpha.max() > 0.95
    torch.testing.assert_close(seen.image, (seen.alpha / 2)[..., None].expand_as(seen.image))


def test_shading_multiplies_light_and_not_coverage(avatar, bent, camera):
    plain = drawn(silent(avatar), bent, camera)
    with torch.no_grad():
        avatar.shading.last.bias.fill_(1.0)
    shaded = drawn(avatar, bent, camera)
    assert torch.equal(shaded.alpha, plain.alpha)
    torch.testing.assert_close(shaded.image, 2 * torch.tensor(1.0).sigmoid() * plain.image)


def test_shades_are_of_the_normals_of_the_posed_mesh_in_the_cameras_axes(loud, bent, camera):
    seen = drawn(loud, bent, camera)
    vertices = seen.vertices[0].detach()
    view = View(camera.K.numpy(), camera.viewmat.numpy(), camera.width, camera.height, 1)
    hits = cast_rays(
        vertices.numpy(), loud.faces.numpy(), view.centre, view.directions.reshape(-1, 3)
    )
    met = torch.from_numpy(hits.triangle >= 0)
    u, v = torch.from_numpy(hits.u), torch.from_numpy(hits.v)
    corners = vertex_normals(vertices, loud.faces)[loud.faces[torch.from_numpy(hits.triangle)]]
    normals = torch.stack([1 - u - v, u, v], dim=1)[..., None] * corners
    normals = torch.nn.functional.normalize(normals.sum(1), dim=1) @ camera.viewmat[:3, :3].T
    beyond = loud.shades(torch.zeros(1, 3))
    wanted = torch.where(met, loud.shades(normals), beyond)
    (found,) = loud.shading_maps(vertices[None], seen.alpha, camera)
    assert met.sum() > 20
    assert (~met & (seen.alpha[0].flatten() > 0)).sum() > 20  # wide Gaussians reach beyond the mesh
    assert (wanted - beyond)[met].abs().mean() > 0.2
    torch.testing.assert_close(found.flatten(), wanted, atol=1e-4, rtol=0)


def test_pixels_that_nothing_covers_are_not_asked_for_a_shade(loud, bent, camera):
    seen = drawn(loud, bent, camera)
    nothing = loud.shading_maps(seen.vertices, torch.zeros(1, 24, 24), camera)
    assert torch.equal(nothing, loud.shades(torch.zeros(1, 3)).expand(1, 24, 24))


def test_a_shade_sees_the_normal_itself_as_well_as_its_encoding(loud):
    normals = torch.nn.functional.normalize(torch.randn(9, 3, generator=seeded(6)), dim=1)
    first = loud.shading.layers[0].weight.data
    assert first.shape[1] == 3 + 12
    for hidden in (slice(0, 3), slice(3, None)):
        kept = first.clone()
        first[:, hidden] = 0
        assert loud.shades(normals).std() > 1e-2
        first.copy_(kept)


def test_gaussians_are_opaque_as_thin_as_said_and_as_soft_as_the_cameras_pixels(
    loud, bent, camera, monkeypatch
):
    seen = {}

    def watched(means, covars, opacities, colors, *args, **options):
        seen.update(covars=covars, opacities=opacities, colors=colors, **options)
        return rasterize(means, covars, opacities, colors, *args, **options)

    monkeypatch.setattr("deblur_avatar.avatars.gomavatar_avatar.rasterize", watched)
    vertices = drawn(loud, bent, camera.binned(0.5)).vertices
    wanted = face_gaussians(vertices, loud.faces, loud.mesh.shapes, 1e-3)[1]
    assert torch.equal(seen["covars"], wanted)
    assert torch.equal(seen["opacities"], torch.ones(len(loud.faces)))
    assert torch.equal(seen["colors"], loud.mesh.colors)
    assert seen["eps2d"] == eps2d_of(2.0) != eps2d_of(1.0)


def test_the_whole_body_and_the_camera_turned_together_make_the_same_picture(loud, bent, camera):
    turn = axis_angle_to_matrix(torch.tensor([0.0, 1.2, 0.3]))
    rotations = axis_angle_to_matrix(bent)
    transforms = loud.transforms(rotations, torch.zeros(3))
    moved = torch.eye(4)
    moved[:3, :3], moved[:3, 3] = turn, torch.tensor([0.5, -0.2, 1.0])
    back = torch.eye(4)
    back[:3, :3], back[:3, 3] = turn.T, -turn.T @ moved[:3, 3]
    along = Camera(camera.K, camera.viewmat @ back, camera.width, camera.height)
    state = loud.condition(rotations, 0, transforms, camera.viewmat)
    here = loud.render(state, transforms[None], camera)
    there = loud.render(state, (moved @ transforms)[None], along)
    apart = (here.image - there.image).abs()
    assert apart.mean() < 1e-4  # but for a pixel where the ray meets another face
    torch.testing.assert_close(here.alpha, there.alpha, atol=1e-3, rtol=0)
    aside = loud.render(state, (moved @ transforms)[None], camera)
    assert (aside.image - here.image).abs().mean() > 1e-2


def test_a_mean_over_instants_is_the_mean_of_their_pictures_each_shaded_by_its_own_normals(
    loud, swinging, camera
):
    rotations = axis_angle_to_matrix(swinging(3, 40.0).axis_angle)
    transforms = loud.transforms(rotations, torch.zeros(3, 3))
    state = loud.condition(rotations[1], 0, transforms[1], camera.viewmat)
    mean = loud.render(state, transforms, camera, average=True)
    each = [loud.render(state, one[None], camera) for one in transforms]
    torch.testing.assert_close(
        mean.image[0], torch.cat([one.image for one in each]).mean(0), atol=1e-6, rtol=0
    )
    torch.testing.assert_close(
        mean.alpha[0], torch.cat([one.alpha for one in each]).mean(0), atol=1e-6, rtol=0
    )
    assert mean.instants == 3
    apart = loud.render(state, transforms, camera)
    torch.testing.assert_close(apart.image, torch.cat([one.image for one in each]))


def test_the_background_is_what_coverage_lets_through_of_it(loud, bent, camera):
    behind = torch.tensor([0.2, 0.5, 0.9])
    for average in (False, True):
        black = drawn(loud, bent, camera, average=average)
        over = drawn(loud, bent, camera, background=behind, average=average)
        wanted = black.image + (1 - black.alpha)[..., None] * behind
        torch.testing.assert_close(over.image, wanted)


def test_nothing_in_sight_is_an_empty_picture_that_has_gradients(loud, bent, camera):
    seen = drawn(loud, bent, camera, transl=(50.0, 0.0, 0.0))
    assert not seen.image.any()
    assert not seen.alpha.any()
    seen.image.sum().backward()
    assert torch.isfinite(loud.mesh.vertices.grad).all()


def test_vertices_wait_for_the_non_rigid_network(loud, bent, camera, recipe):
    start = recipe.fitting.nonrigid.start
    for scale in (1.0, 0.1):
        for iteration in (round(start * scale), round(start * scale) + 1):
            loud.zero_grad()
            step = step_at(recipe, iteration, scale)
            drawn(loud, bent, camera, step=step).vertices.square().sum().backward()
            waits = loud.offsets.last.weight.grad is None
            assert waits == (iteration == round(start * scale))
            assert loud.mesh.vertices.grad.any()


def offsets_at(avatar, angles, step=None):
    rotations = axis_angle_to_matrix(angles)
    transforms = avatar.transforms(rotations, torch.zeros(3))
    vertices = avatar.condition(rotations, 0, transforms, torch.eye(4), step).vertices
    return (vertices - avatar.mesh.vertices).detach()


@pytest.mark.parametrize("scale", [1.0, 0.2])
def test_frequencies_are_let_in_one_after_the_other(loud, bent, recipe, scale):
    fitting = recipe.fitting.nonrigid
    halfway = (fitting.start + fitting.full) / 2
    pose = bent[1:].flatten() + 1e-2
    for iteration, share in ((halfway, 0.5), (fitting.full, 1.0), (2 * fitting.full, 1.0)):
        encoded = frequency_encoding(loud.mesh.vertices, 3, hann_window(share, 3))
        found = offsets_at(loud, bent, step_at(recipe, round(iteration * scale), scale))
        wanted = loud.offsets(encoded, pose)
        torch.testing.assert_close(found, wanted, atol=1e-5, rtol=0)
    torch.testing.assert_close(found, offsets_at(loud, bent), atol=1e-6, rtol=0)
    first = offsets_at(loud, bent, step_at(recipe, fitting.start + 1))
    assert first.std(0).max() < 1e-3  # as good as the same everywhere
    assert found.std(0).max() > 1e-2


def test_offsets_are_added_to_vertices_that_go_on_learning(avatar, bent):
    rotations = axis_angle_to_matrix(bent)
    transforms = avatar.transforms(rotations, torch.zeros(3))
    state = silent(avatar).condition(rotations, 0, transforms, torch.eye(4))
    state.vertices.sum().backward()
    assert torch.equal(avatar.mesh.vertices.grad, torch.ones_like(avatar.mesh.vertices))


def test_the_non_rigid_network_sees_the_pose_but_not_how_the_body_is_turned(loud, bent):
    turned, other = bent.clone(), bent.clone()
    turned[0] = torch.tensor([0.0, 2.0, 0.0])
    other[7] = turned[0]
    assert torch.equal(offsets_at(loud, bent), offsets_at(loud, turned))
    assert not torch.allclose(offsets_at(loud, bent), offsets_at(loud, other), atol=1e-4)


def test_every_unknown_gets_a_gradient_from_pictures(loud, bent, camera):
    drawn(loud, bent, camera).image.square().sum().backward()
    for name, value in loud.named_parameters():
        assert torch.isfinite(value.grad).all(), name
        assert value.grad.any(), name


def test_shading_alone_moves_vertices_by_their_normals(loud, bent, camera):
    seen = drawn(silent(loud), bent, camera)
    with torch.no_grad():
        loud.shading.last.weight.normal_(generator=seeded(5))
    posed = seen.vertices.detach().requires_grad_()
    loud.shading_maps(posed, seen.alpha, camera).sum().backward()
    assert posed.grad.any()


def test_every_regulariser_has_a_weight_and_pulls_at_what_it_is_named_after(
    loud, bent, camera, recipe
):
    step = step_at(recipe, 1)
    rendering = drawn(loud, bent, camera, step=step)
    terms = loud.regularisers(rendering, step)
    assert terms.keys() == recipe.fitting.weights(step, 0.5).keys()
    pulled = {
        "laplacian": "mesh.vertices",
        "normal_consistency": "mesh.vertices",
        "color_consistency": "mesh.colors",
    }
    for name, term in terms.items():
        loud.zero_grad()
        term().backward(retain_graph=True)
        moved = {n for n, p in loud.named_parameters() if p.grad is not None and p.grad.any()}
        assert moved == {pulled[name]}, name
    posed = laplacian(rendering.vertices, mesh_edges(loud.faces))
    assert terms["laplacian"]() == posed != laplacian(loud.mesh.vertices[None], loud.edges)


def test_every_unknown_has_one_learning_rate(avatar, recipe):
    rates_of_all_unknowns(avatar, recipe)
    all_unknowns_are_in_networks(avatar)
    parts = {"shading": "shading.", "nonrigid": "offsets."}
    for group, named in avatar.parameter_groups().items():
        assert all(name.startswith(parts.get(group, f"mesh.{group}")) for name, _ in named)


def test_every_learning_rate_falls_to_a_tenth(recipe):
    rates = recipe.fitting.learning_rates(recipe.final_share)
    ends = {name: (rate.at(0.0), rate.at(1.0)) for name, rate in rates.items()}
    fast = dict.fromkeys(("turns", "scales", "colors", "shading", "nonrigid"), (5e-3, 5e-4))
    assert ends.keys() == {"vertices", *fast}
    for name, pair in {"vertices": (1e-3, 1e-4), **fast}.items():
        assert ends[name] == pytest.approx(pair), name


def test_no_unknown_is_a_gaussian_that_densification_edits(avatar, recipe, schedule, observations):
    params = FitParams(recipe=recipe, motion=FixedParams(kind="fixed"), schedule=schedule)
    optimizers = Optimizers(avatar, FixedMotion(observations.poses), None, params)
    assert optimizers.gaussians is None
    moved = [value for group in optimizers.others.param_groups for value in group["params"]]
    assert set(moved) == set(avatar.parameters())


def test_a_window_that_closes_before_it_opens_is_refused(content):
    content["fitting"]["nonrigid"]["full"] = content["fitting"]["nonrigid"]["start"]
    with pytest.raises(ConfigError, match="full must be after start = 7500, got 7500"):
        parse(RecipeParams, content, "avatars.gomavatar")


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("thickness_m", 0.0),
        ("shading.hidden", []),
        ("nonrigid.hidden", []),
        ("nonrigid.frequencies", 0),
    ],
)
def test_models_that_cannot_be_made_are_refused(content, path, value):
    model_is_refused(GomavatarParams, content["model"], path, value)


def test_a_saved_avatar_is_drawn_as_it_was(loud, body, swinging, camera, tmp_path):
    is_drawn_as_saved(loud, body, swinging(2, 30.0), camera, tmp_path / "avatar")


def test_a_short_fit_explains_the_frames_better(observations, recipe, schedule):
    fast = {"vertices": 2e-3, "scales": 0.02, "turns": 0.02, "colors": 0.03}
    quick = changed(recipe, "fitting.rates", **fast)
    _, terms = fitted_twice(observations, quick, schedule, 60)
    for name, share in {"l1": 0.7, "structure": 0.7, "mask": 0.9}.items():
        values = [one[name] for one in terms]
        assert sum(values[-10:]) < share * sum(values[:10]), name


def test_a_fit_that_was_stopped_ends_with_the_same_bytes(
    observations, recipe, schedule, monkeypatch, tmp_path
):
    memory, remembered = stopped_ends_with_the_same_bytes(
        partial(fitted, observations, recipe, schedule, 18), monkeypatch, tmp_path / "warmup",
        refresh=6, stop_at=15, saved_at=11,
    )  # fmt: skip
    assert memory.tensors.keys() == remembered.tensors.keys()
    assert memory.tensors
    for name, value in memory.tensors.items():
        assert torch.equal(value, remembered.tensors[name]), name


def test_no_rig_carries_it_and_the_error_says_why(avatar, observations, motion):
    nothing_exports_it(avatar, "whose vertices a network moves", observations, motion)
