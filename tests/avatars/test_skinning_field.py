import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, SMPL_PARENTS
from deblur_avatar.avatars.skinning_field import SkinningField, surface_weights

pytestmark = pytest.mark.portable

JOINT = {name: index for index, name in enumerate(SMPL_JOINT_NAMES)}


@pytest.fixture
def field():
    torch.manual_seed(0)
    return SkinningField(SMPL_PARENTS, [8], "float32").double()


def logits_of(field, count=50, size=3.0):
    outputs = field.network.last.out_features
    generator = torch.Generator().manual_seed(0)
    return size * torch.randn(count, outputs, generator=generator, dtype=torch.float64)


def handed_down(field, logits):
    """Mass walks down the tree: a joint keeps a share and its children divide the rest."""
    children = [[j for j, p in enumerate(SMPL_PARENTS) if p == k] for k in range(24)]
    inner = [k for k in range(24) if children[k]]
    shared = [child for k in inner for child in children[k]]
    arriving, weights = torch.zeros(24).double(), torch.zeros(24).double()
    arriving[0] = 1
    for joint in range(24):
        if not children[joint]:
            weights[joint] = arriving[joint]
            continue
        passed = arriving[joint] * logits[len(shared) + inner.index(joint)].sigmoid()
        weights[joint] = arriving[joint] - passed
        shares = torch.stack([logits[shared.index(c)] for c in children[joint]]).softmax(0)
        for child, share in zip(children[joint], shares, strict=True):
            arriving[child] = passed * share
    return weights


@pytest.mark.parametrize("size", [0.0, 3.0, 1000.0])
def test_weights_are_shares_of_one_whatever_the_network_says(field, size):
    weights = field.from_logits(logits_of(field, size=size))
    assert weights.shape == (50, 24)
    assert (weights >= 0).all()
    torch.testing.assert_close(weights.sum(1), torch.ones(50).double())


def test_weights_are_what_is_left_when_mass_walks_down_the_tree(field):
    logits = logits_of(field, 4)
    expected = torch.stack([handed_down(field, row) for row in logits])
    torch.testing.assert_close(field.from_logits(logits), expected)


def test_mass_reaches_a_hand_only_through_its_arm(field):
    logits = logits_of(field)
    below = ["left_elbow", "left_wrist", "left_hand"]
    before = field.from_logits(logits)[:, [JOINT[name] for name in below]].sum(1)
    assert (before > 0).all()
    inner = [k for k in range(24) if k in SMPL_PARENTS]
    edges = sum(parent >= 0 for parent in SMPL_PARENTS)
    logits[:, edges + inner.index(JOINT["left_shoulder"])] = -1e4  # the shoulder keeps it all
    weights = field.from_logits(logits)
    assert weights[:, [JOINT[name] for name in below]].max() == 0
    assert (weights[:, JOINT["right_hand"]] > 0).all()
    torch.testing.assert_close(weights.sum(1), torch.ones(50).double())


def test_weights_change_smoothly_with_the_logits(field):
    assert torch.autograd.gradcheck(field.from_logits, logits_of(field, 2).requires_grad_())


def test_weights_are_those_of_the_place(field):
    points = torch.rand(5, 3).double() * 2 - 1
    together = field(points)
    torch.testing.assert_close(together[3:4], field(points[3:4]))
    assert (together[0] - together[1]).abs().max() > 0


def test_a_point_on_a_vertex_has_the_weights_of_that_vertex(body):
    chosen = [0, 100, 300]
    weights = surface_weights(body.vertices[chosen], body.vertices, body)
    torch.testing.assert_close(weights, body.lbs_weights[chosen], atol=0.02, rtol=0)


def test_a_point_off_the_surface_is_a_mixture_of_its_nearest_vertices(body):
    points = body.vertices[::7] + 0.01
    weights = surface_weights(points, body.vertices, body)
    torch.testing.assert_close(weights.sum(1), torch.ones(len(points)))
    distance = torch.cdist(points[:1], body.vertices)[0]
    nearest = distance.argsort()[:4]
    nearness = 1 / (distance[nearest] + 1e-4)
    expected = (nearness[:, None] * body.lbs_weights[nearest]).sum(0) / nearness.sum()
    torch.testing.assert_close(weights[0], expected, atol=1e-5, rtol=1e-4)
