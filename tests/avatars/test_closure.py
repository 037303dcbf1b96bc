import copy

import pytest
import torch
from scipy.ndimage import distance_transform_edt

from deblur_avatar.avatars.avatar import TrainingStep
from deblur_avatar.avatars.closure import COVERED, INSIDE, VIEWS, closure_views, open_share
from deblur_avatar.avatars.plain_avatar import LOOKS_EVERY, PART_SEEN
from deblur_avatar.bodies.triangle_joints import triangle_joints
from deblur_avatar.geometry.cameras import camera_centres

pytestmark = pytest.mark.portable


@pytest.fixture
def views(avatar):
    return closure_views(avatar.canonical_vertices, avatar.body, {})


@pytest.fixture
def step(plain_recipe):
    return lambda iteration: TrainingStep(
        iteration, 1.0, plain_recipe.fitting, torch.Generator().manual_seed(0)
    )


def seen(avatar, camera):
    """The avatar in its canonical pose."""
    still = torch.eye(4).expand(1, len(avatar.body.parents), 4, 4)
    state = avatar.condition(still[0, :, :3, :3], 0, still[0], camera.viewmat)
    return avatar.render(state, still, camera)


@pytest.fixture
def look_share(views):
    """What the regulariser says, whatever was rendered of the frame."""

    def of(avatar, step):
        rendering = seen(avatar, views[0].camera)
        return avatar.regularisers(rendering, step)["closed"]()

    return of


def holed(avatar, joint):
    """Without the Gaussians of one joint's surface."""
    weights = avatar.weights_at(avatar.gaussians.means)
    own = weights.argmax(1) == avatar.body.joint_names.index(joint)
    assert own.any()
    with torch.no_grad():
        avatar.gaussians.opacity_logits[own] = -30.0
    return avatar


def test_views_come_from_all_sides_and_see_the_whole_body(avatar, views):
    middle = avatar.canonical_vertices.aminmax(dim=0)
    middle = (middle.min + middle.max) / 2
    towards = torch.stack([camera_centres(view.camera.viewmat) for view in views]) - middle
    towards = torch.nn.functional.normalize(towards, dim=1)
    assert len(views) == VIEWS
    torch.testing.assert_close(towards.mean(0), torch.zeros(3), atol=0.05, rtol=0)
    nearest = (towards @ towards.T - 2 * torch.eye(VIEWS)).max(1).values
    assert nearest.max() < 0.95  # 18 degrees: none twice
    for view in views:
        body = view.triangles >= 0
        assert body.any()
        assert not (body[0] | body[-1]).any()
        assert not (body[:, 0] | body[:, -1]).any()


def test_neighbours_in_order_are_far_apart(views):
    towards = torch.stack([camera_centres(view.camera.viewmat) for view in views])
    towards = torch.nn.functional.normalize(towards - towards.mean(0), dim=1)
    assert (towards * towards.roll(1, 0)).sum(1).max() < 0.8


def test_what_has_to_be_covered_lies_deep_inside_the_body(views):
    for view in views:
        depth = torch.from_numpy(distance_transform_edt((view.triangles >= 0).numpy()))
        assert view.inside.any()
        assert depth[view.inside].min() > 1
        # The rim beside the thickest part stays free: a person may be thinner than her body.
        row, column = divmod(int(depth.argmax()), depth.shape[1])
        near = (slice(max(row - 3, 0), row + 4), slice(max(column - 3, 0), column + 4))
        assert not view.inside[near][depth[near] <= INSIDE * depth.max()].any()
        assert view.inside[depth == depth.max()].all()


def test_a_joint_is_covered_nearer_to_the_silhouette_and_no_other(avatar, views):
    head = triangle_joints(avatar.body) == avatar.body.joint_names.index("head")
    nearer = closure_views(avatar.canonical_vertices, avatar.body, {"head": 0.2})
    added = 0
    for view, near in zip(views, nearer, strict=True):
        assert torch.equal(view.triangles, near.triangles)
        own = head[view.triangles] & (view.triangles >= 0)
        assert torch.equal(view.inside[~own], near.inside[~own])
        assert not (view.inside & ~near.inside).any()
        depth = torch.from_numpy(distance_transform_edt((near.triangles >= 0).numpy()))
        # Of what is as thick as the thickest part of all, whatever lies that deep.
        assert near.inside[own & (depth > max(1, 0.2 * depth.max()))].all()
        added += int(near.inside.sum() - view.inside.sum())
    assert added > 0


def test_only_what_is_missing_counts():
    whole = torch.ones(5)
    assert open_share(whole) == 0
    assert open_share(COVERED * whole) == 0
    torch.testing.assert_close(open_share(0 * whole), torch.tensor(COVERED))
    torch.testing.assert_close(open_share(torch.tensor([1.0, 0.5])), torch.tensor(0.15))


def test_coverage_is_the_canonical_avatars_well_inside_the_body(avatar, views):
    still = torch.eye(3).expand(len(avatar.body.parents), 3, 3)
    coverage = views[0].coverage(avatar, still, 0)
    assert torch.equal(coverage, seen(avatar, views[0].camera).alpha[0][views[0].inside])


def test_copies_of_a_fit_share_their_views(avatar, step, look_share):
    look_share(avatar, step(0))
    assert copy.deepcopy(avatar)._views[0] is avatar._views[0]


def test_a_hole_counts_from_a_side_that_sees_it_and_is_closed_by_descent(avatar, step, look_share):
    looks = [step(LOOKS_EVERY * turn) for turn in range(VIEWS)]
    whole = torch.stack([look_share(avatar, look) for look in looks])
    torn = torch.stack([look_share(holed(avatar, "left_knee"), look) for look in looks])
    assert (torn >= whole - 1e-6).all()
    assert (torn > whole + 0.01).sum() > VIEWS / 3
    optimizer = torch.optim.Adam(avatar.parameters(), lr=0.02)
    for look in looks * 3:
        optimizer.zero_grad()
        look_share(avatar, look).backward()
        optimizer.step()
    closed = torch.stack([look_share(avatar, look) for look in looks])
    assert closed.mean() < 0.3 * torn.mean()


def test_every_third_step_looks_for_all_three(avatar, views, step, look_share):
    holed(avatar, "left_knee")
    rendering = seen(avatar, views[0].camera)
    for iteration in range(1, LOOKS_EVERY):
        assert "closed" not in avatar.regularisers(rendering, step(iteration))
    for turn in (1, VIEWS + 1):
        alpha = seen(avatar, views[1].camera).alpha[0][views[1].inside]
        looked = look_share(avatar, step(turn * LOOKS_EVERY))
        torch.testing.assert_close(looked, LOOKS_EVERY * open_share(alpha))


def test_it_weighs_where_part_of_the_body_is_never_seen_and_nowhere_else(plain_recipe, step):
    fitting = plain_recipe.fitting
    held = fitting.regularisers.model_copy(update={"closed": 0.02, "smooth_colors": 0.5})
    fitting = fitting.model_copy(update={"regularisers": held})
    seen, part = (fitting.weights(step(1), share) for share in (PART_SEEN, PART_SEEN + 0.01))
    assert (seen["closed"], part["closed"]) == (0.0, 0.02)
    assert part["smooth_colors"] == pytest.approx(0.5 * (PART_SEEN + 0.01) ** 2)
