import pytest
import torch

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.gauhuman_avatar import GauhumanAvatar, GauhumanParams
from deblur_avatar.bodies.posed_body import posed_vertices
from deblur_avatar.config.reading import parse
from deblur_avatar.exports.posed_gaussians import posed_frame
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import invert_rigid
from deblur_avatar.training.params import RecipeParams
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


@pytest.fixture
def recipe(tiny_content):
    content = tiny_content["avatars"]["gauhuman"]
    content["model"]["weight_offsets"] = {"frequencies": 4, "hidden": [8, 8]}
    return parse(RecipeParams, content, "avatars.gauhuman")


@pytest.fixture
def avatar(body, recipe):
    """Freshly made: offsets are 0."""
    torch.manual_seed(0)
    betas = torch.tensor([0.3, 0.2])
    return GauhumanAvatar.create(recipe.model, body, betas, FRAMES, 120, "srgb", seeded())


@pytest.fixture
def taught(avatar):
    """One with other weights than the body's, and colours of the view."""
    with torch.no_grad():
        avatar.weight_offsets.last.weight.normal_(generator=seeded(1))
        avatar.gaussians.features.normal_(generator=seeded(2))
    return avatar


@pytest.fixture
def bent(body):
    return 0.4 * torch.randn(len(body.parents), 3, generator=seeded(7))  # radians


@pytest.fixture
def conditioned(avatar, front):
    def make(
        angles, turn=(0.0, 0.0, 0.0), transl=(0.0, 0.0, 0.0), viewmat=front.viewmats[0], step=None
    ):
        rotations = axis_angle_to_matrix(torch.cat([torch.tensor([turn]), angles[1:]]))
        transforms = avatar.transforms(rotations, torch.tensor(transl))
        return avatar.condition(rotations, 0, transforms, viewmat, step), transforms

    return make


def step_at(recipe, iteration):
    return TrainingStep(iteration, 1.0, recipe.fitting, seeded())


def test_with_offsets_of_zero_every_vertex_bends_with_the_body(avatar, body, bent):
    with torch.no_grad():
        avatar.gaussians.means = torch.nn.Parameter(avatar.canonical_vertices.clone())
    weights = avatar.weights_at(avatar.gaussians.means)
    torch.testing.assert_close(weights, body.lbs_weights, atol=1e-6, rtol=0)
    transl = torch.tensor([1.0, 2.0, 3.0])
    transforms = avatar.transforms(axis_angle_to_matrix(bent), transl)
    blended = torch.einsum("nj,jrc->nrc", weights, transforms[:, :3])
    found = (blended[..., :3] @ avatar.canonical_vertices[..., None])[..., 0] + blended[..., 3]
    wanted = posed_vertices(body, avatar.betas, bent[0], bent[1:], transl)
    alone = weights.amax(1) > 0.999  # between joints, two blends are not one
    assert alone.float().mean() > 0.3
    torch.testing.assert_close(found[alone], wanted[alone], atol=1e-5, rtol=0)
    assert (found - wanted).norm(dim=1).quantile(0.95) < 0.005  # metres


def test_the_canonical_pose_leaves_every_gaussian_where_it_is(taught, front):
    still = torch.eye(4).expand(len(taught.body.parents), 4, 4)
    state = taught.condition(still[:, :3, :3], 0, still, front.viewmats[0])
    means, covars = state.posed(still[None])
    torch.testing.assert_close(means[0], taught.gaussians.means, atol=1e-6, rtol=0)
    torch.testing.assert_close(covars[0], taught.canonical_covariances(), atol=1e-7, rtol=1e-4)


def test_the_body_moves_as_a_whole(taught, conditioned, bent):
    angles, shift = (0.2, 1.0, -0.3), (1.0, -2.0, 3.0)
    here, transforms = conditioned(bent)
    there, moved = conditioned(bent, angles, shift)
    rest = transforms[0].inverse()
    rigid = moved[0] @ rest
    means, turned = here.posed(transforms[None])[0][0], there.posed(moved[None])[0][0]
    torch.testing.assert_close(turned, means @ rigid[:3, :3].T + rigid[:3, 3], atol=1e-5, rtol=0)


def test_colours_turn_with_the_body(taught, conditioned, bent, front):
    angles, shift = (0.0, 1.2, 0.0), (0.5, 0.0, -0.5)
    here, transforms = conditioned(bent)
    there, moved = conditioned(bent, angles, shift)
    assert (here.colors - there.colors).abs().max() > 0.01
    rigid = moved[0] @ invert_rigid(transforms[0])
    viewmat = front.viewmats[0] @ invert_rigid(rigid)  # the camera goes round with it
    along, _ = conditioned(bent, angles, shift, viewmat)
    torch.testing.assert_close(along.colors, here.colors, atol=1e-4, rtol=0)


def test_the_degree_of_colours_rises(taught, conditioned, bent, recipe):
    first, second = recipe.fitting.harmonics_up_at
    constant = (0.5 + 0.28209479 * taught.gaussians.features[:, :3]).clamp(min=0)
    seen = [
        conditioned(bent, step=step_at(recipe, at))[0].colors
        for at in (first, first + 1, second + 1)
    ]
    torch.testing.assert_close(seen[0], constant)
    assert not torch.allclose(seen[1], constant)
    assert not torch.allclose(seen[2], seen[1])
    assert torch.equal(seen[2], conditioned(bent)[0].colors)


def test_nearest_vertices_are_looked_up_until_gaussians_have_moved(avatar):
    means = avatar.gaussians.means
    before = avatar.weights_at(means)
    with torch.no_grad():
        means.copy_(means.flip(0))
    torch.testing.assert_close(avatar.weights_at(means), before)
    avatar.invalidate_neighbours()
    torch.testing.assert_close(avatar.weights_at(means), before.flip(0))
    with torch.no_grad():
        avatar.gaussians.means = torch.nn.Parameter(means[:7].clone())
    torch.testing.assert_close(avatar.weights_at(avatar.gaussians.means), before.flip(0)[:7])


def test_every_unknown_has_one_learning_rate_that_of_the_release(avatar, recipe):
    rates = rates_of_all_unknowns(avatar, recipe)
    ends = {name: (rate.at(0.0), rate.at(1.0)) for name, rate in rates.items()}
    a_tenth = 1.6e-4 * 0.01**0.1  # of the release's 30,000 iterations
    assert ends["means"] == pytest.approx((1.6e-4, a_tenth), rel=1e-3)
    assert ends["weight_offsets"] == pytest.approx((5e-5, 5e-5))
    assert ends["features"] == pytest.approx((2.5e-3, 2.5e-3))


def test_it_densifies_by_divergence_near_the_body(avatar, recipe):
    params = recipe.fitting.densify
    with torch.no_grad():
        avatar.gaussians.means[3] += 1.0
    keep, added = avatar.edits(torch.ones(120), params, 1000, seeded())
    assert not keep[3]
    assert sum(len(part["means"]) for part in added) > 0
    assert sum(len(part["means"]) for part in avatar.edits(
        torch.zeros(120), params, 1000, seeded()
    )[1]) == 0  # fmt: skip


@pytest.mark.parametrize(
    ("key", "value"),
    [("weight_offsets", {"frequencies": 4, "hidden": [8]}), ("harmonics", -1)],
)
def test_models_that_cannot_be_made_are_refused(tiny_content, key, value):
    model_is_refused(GauhumanParams, tiny_content["avatars"]["gauhuman"]["model"], key, value)


def test_a_saved_avatar_is_drawn_as_it_was(taught, body, swinging, front, tmp_path):
    is_drawn_as_saved(taught, body, swinging(2, 30.0), front.camera(0), tmp_path / "avatar")


def test_a_short_fit_explains_the_frames_better_and_densifies_by_its_own_rule(
    observations, recipe, schedule, monkeypatch
):
    asked = []
    own = GauhumanAvatar.edits

    def edits(self, *given):
        asked.append(given)
        return own(self, *given)

    monkeypatch.setattr(GauhumanAvatar, "edits", edits)
    quick = changed(recipe, "fitting.rates", features=0.02)
    found, terms = fitted_twice(observations, quick, schedule, 60)
    assert asked
    pictures = [sum(one.values()) for one in terms]
    assert sum(pictures[-10:]) < 0.7 * sum(pictures[:10])
    assert found.networks["weight_offsets.last.weight"].any()


def test_no_rig_carries_it_and_the_error_says_why(taught, observations, motion):
    run = no_rig_carries_it(taught, "whose colours depend on the view", observations, motion)
    assert len(posed_frame(run, 0).means) == 120
