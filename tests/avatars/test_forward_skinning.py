import pytest
import torch

from deblur_avatar.avatars.avatar import canonical_vertices
from deblur_avatar.avatars.forward_skinning import ForwardSkinning, attached, baked
from deblur_avatar.avatars.gaussians import sample_surface
from deblur_avatar.avatars.plain_avatar import PlainAvatar, PlainParams
from deblur_avatar.avatars.weight_volume import base_weights, smoothed
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import skin_points
from tests.randomness import seeded

pytestmark = pytest.mark.portable


@pytest.fixture(scope="module")
def vertices(body):
    return canonical_vertices(body, torch.zeros(2))


@pytest.fixture(scope="module")
def grid(body, vertices):
    """Weights as smooth as a network's."""

    def weights_at(points):
        cube = points.unflatten(0, (24, 24, 24))
        found = smoothed(base_weights(vertices, body.lbs_weights, cube), 8)
        return (found / found.sum(0)).flatten(1).T

    return baked(weights_at, vertices, 24)


@pytest.fixture(scope="module")
def transforms(body):
    """Of a moderate pose."""
    avatar = PlainAvatar.create(
        PlainParams(kind="plain"), body, torch.zeros(2), 1, 10, "srgb", seeded()
    )
    angles = 0.2 * torch.randn(24, 3, generator=seeded(7))
    return avatar.transforms(axis_angle_to_matrix(angles), torch.tensor([0.3, -0.1, 0.2]))


@pytest.fixture
def skinning(body, vertices, grid, transforms):
    return ForwardSkinning(grid, transforms, vertices, body.lbs_weights)


def on_body(body, vertices, count=300):
    return sample_surface(vertices, body.faces, count, seeded(3))[0]


def test_weights_are_asked_for_at_the_nodes_and_are_theirs_again(vertices):
    asked = []

    def weights_at(points):
        asked.append(points)
        return torch.stack([points[:, 0], points[:, 1] + points[:, 2]], dim=1)

    grid = baked(weights_at, vertices, 5)
    assert len(asked[0]) == 125
    torch.testing.assert_close(asked[0].amin(0), vertices.amin(0) - 0.15)
    torch.testing.assert_close(asked[0].amax(0), vertices.amax(0) + 0.15)
    x = torch.linspace(float(grid.low[0]), float(grid.high[0]), 5)
    torch.testing.assert_close(grid.weights[0, 2, 3], x)  # nodes along z, y, x
    assert not grid.weights.requires_grad


def test_points_move_by_the_weights_of_the_grid(body, vertices, grid, transforms, skinning):
    points = on_body(body, vertices)
    places = 2 * (points - (grid.low + grid.high) / 2) / (grid.high - grid.low)
    weights = torch.nn.functional.grid_sample(
        grid.weights[None], places[None, :, None, None], align_corners=True
    )[0, :, :, 0, 0].T
    wanted = skin_points(points, weights, transforms)
    torch.testing.assert_close(skinning.skinned(points), wanted, atol=1e-5, rtol=0)


def test_every_point_of_the_surface_is_found_again(body, vertices, skinning):
    points = on_body(body, vertices)
    posed = skinning.skinned(points)
    _, nearest = skinning.nearest(posed)
    found, sure = skinning.canonical(posed, nearest)
    assert sure.float().mean() > 0.97
    torch.testing.assert_close(skinning.skinned(found[sure]), posed[sure], atol=1.1e-3, rtol=0)
    # Where no other part of the body got to the same place, it is the very point.
    same = (found - points).norm(dim=1) < 2e-3
    assert same[sure].float().mean() > 0.9
    exact = (skinning.skinned(found) - posed).norm(dim=1) < 1e-4
    assert exact.float().mean() > 0.9


def test_a_body_that_does_not_bend_is_taken_back_at_once(body, vertices, grid):
    moved = torch.eye(4).repeat(24, 1, 1)
    moved[:, :3, :3] = axis_angle_to_matrix(torch.tensor([0.3, 1.0, -0.2]))
    moved[:, :3, 3] = torch.tensor([1.0, 2.0, 3.0])
    skinning = ForwardSkinning(grid, moved, vertices, body.lbs_weights)
    points = on_body(body, vertices, 40)
    posed = points @ moved[0, :3, :3].T + moved[0, :3, 3]
    distance, nearest = skinning.nearest(posed)
    torch.testing.assert_close(
        distance, torch.cdist(posed, skinning.posed).amin(1), atol=1e-3, rtol=0
    )
    found, sure = skinning.canonical(posed, nearest)
    assert sure.all()
    torch.testing.assert_close(found, points, atol=1e-4, rtol=0)


def test_what_no_point_is_moved_to_is_not_found(body, vertices, skinning):
    far = torch.tensor([[5.0, 5.0, 5.0], [0.0, 0.0, -4.0]])
    torn = ForwardSkinning(skinning._grid, torch.zeros(24, 4, 4), vertices, body.lbs_weights)
    _, sure = torn.canonical(far, torch.zeros(2, dtype=torch.long))
    assert not sure.any()


def test_a_search_that_failed_begins_again_from_bones(
    body, vertices, grid, transforms, monkeypatch
):
    away = torch.eye(4)
    away[:3, 3] = torch.tensor([30.0, 0.0, -20.0])
    skinning = ForwardSkinning(grid, away @ transforms, vertices, body.lbs_weights)
    points = on_body(body, vertices)
    posed = skinning.skinned(points)
    wrong = torch.randperm(len(vertices), generator=seeded(5))[: len(points)]
    monkeypatch.setattr("deblur_avatar.avatars.forward_skinning.STARTS", 0)
    alone = skinning.canonical(posed, wrong)[1].float().mean()
    monkeypatch.setattr("deblur_avatar.avatars.forward_skinning.STARTS", 2)
    both = skinning.canonical(posed, wrong)[1].float().mean()
    assert both > alone + 0.02
    _, nearest = skinning.nearest(posed)
    assert skinning.canonical(posed, nearest)[1].float().mean() > 0.97


def test_the_inverse_jacobian_says_how_points_follow(body, vertices, skinning):
    points = on_body(body, vertices, 60)
    inverse, regular = skinning.inverse_jacobian(points)
    assert regular.float().mean() > 0.9
    small = 1e-3 * torch.randn(60, 3, generator=seeded(4))
    moved = skinning.skinned(points + small) - skinning.skinned(points)
    back = (inverse @ moved[..., None])[..., 0]
    off = ((back - small).norm(dim=1) / small.norm(dim=1))[regular]
    assert off.median() < 0.02  # but for those next to a node, where weights have a corner
    with torch.no_grad():
        torch.testing.assert_close(skinning.inverse_jacobian(points)[0], inverse)


def test_what_has_no_inverse_is_told_and_does_no_harm(body, vertices, grid):
    flat = torch.eye(4).repeat(24, 1, 1)
    flat[:, 2, 2] = 0
    skinning = ForwardSkinning(grid, flat, vertices, body.lbs_weights)
    inverse, regular = skinning.inverse_jacobian(on_body(body, vertices, 9))
    assert not regular.any()
    assert torch.isfinite(inverse).all()


def test_a_roots_gradient_is_what_small_changes_of_the_joints_do_to_it(
    body, vertices, grid, transforms
):
    grid = type(grid)(grid.low.double(), grid.high.double(), grid.weights.double())
    own = vertices.double(), body.lbs_weights.double()
    joints = transforms.double()
    skinning = ForwardSkinning(grid, joints, *own)
    posed = skinning.skinned(on_body(body, vertices, 40).double())

    def roots(moved):
        skinning = ForwardSkinning(grid, moved, *own)
        points = skinning.canonical(posed, skinning.nearest(posed)[1])[0]
        for _ in range(3):  # to the last digit
            inverse, _ = skinning.inverse_jacobian(points)
            points = points - (inverse @ (skinning.skinned(points) - posed)[..., None])[..., 0]
        return points, inverse

    points, inverse = roots(joints)
    places = 2 * (points - (grid.low + grid.high) / 2) / (grid.high - grid.low)
    weights = torch.nn.functional.grid_sample(
        grid.weights[None], places[None, :, None, None], align_corners=True
    )[0, :, :, 0, 0].T
    way = torch.zeros_like(joints)
    way[:, :3] = torch.randn(24, 3, 4, generator=seeded(8), dtype=torch.double)
    given = joints.clone().requires_grad_()
    found = attached(points, inverse, weights, given)
    torch.testing.assert_close(found, points)
    small, columns = 1e-6, []
    for axis in range(3):
        gradient = torch.autograd.grad(found[:, axis].sum(), given, retain_graph=True)[0]
        columns.append(float((gradient * way).sum()))
    change = (roots(joints + small * way)[0] - roots(joints - small * way)[0]) / (2 * small)
    settled = change.norm(dim=1) < 30  # a point on the border of two cells may go to either side
    assert settled.float().mean() > 0.9
    torch.testing.assert_close(
        torch.tensor(columns, dtype=torch.double), change.sum(0), rtol=0.02, atol=0.05
    )


def test_a_roots_gradient_reaches_weights_too(body, vertices, transforms, skinning):
    points = on_body(body, vertices, 12)
    inverse, _ = skinning.inverse_jacobian(points)
    weights = torch.full((12, 24), 1 / 24, requires_grad=True)
    attached(points, inverse, weights, transforms).sum().backward()
    assert weights.grad.any()
