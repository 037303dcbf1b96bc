import dataclasses

import pytest
import torch

from deblur_avatar.avatars.latent_bones import LatentBones, with_latent_bones
from deblur_avatar.bodies.posed_body import shaped_joints, transforms_from_rotations
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import blend_transforms, transform_points
from tests.randomness import seeded

pytestmark = pytest.mark.portable

JOINTS = 24
SHIFT = torch.tensor([1.0, -2.0, 3.0])


def turns(seed=0, dtype=torch.float32):
    drawn = 0.4 * torch.randn(JOINTS, 3, generator=seeded(seed), dtype=dtype)
    return axis_angle_to_matrix(drawn)


@pytest.fixture
def bones():
    torch.manual_seed(0)
    return LatentBones(JOINTS, 4, [16, 16])


@pytest.fixture
def body(body):
    """A body whose root is not where space begins."""
    apart = torch.tensor([0.1, 0.9, -0.2])
    return dataclasses.replace(body, vertices=body.vertices + apart, joints=body.joints + apart)


@pytest.fixture
def root(body):
    return shaped_joints(body, torch.zeros(body.shape_dirs.shape[2]))[0]


@pytest.fixture
def posed(body):
    """Joint transforms at rest turned and moved."""

    def make(rotations, transl=SHIFT):
        betas = torch.zeros(body.shape_dirs.shape[2])
        return transforms_from_rotations(body, betas, rotations, transl)

    return make


def test_bones_start_all_but_still(bones):
    moved = bones(turns())
    assert moved.shape == (4, 4, 4)
    torch.testing.assert_close(moved, torch.eye(4).expand(4, 4, 4), atol=0.02, rtol=0)
    assert not torch.equal(moved, torch.eye(4).expand(4, 4, 4))
    with torch.no_grad():
        bones.head.weight.zero_()
    assert torch.equal(bones(turns()), torch.eye(4).expand(4, 4, 4))


def test_bones_are_rigid_and_no_two_alike(bones):
    with torch.no_grad():
        bones.head.weight.normal_(generator=seeded())
    rows = bones(turns())
    rotation = rows[:, :3, :3]
    torch.testing.assert_close(
        rotation @ rotation.mT, torch.eye(3).expand(4, 3, 3), atol=1e-5, rtol=0
    )
    torch.testing.assert_close(torch.linalg.det(rotation), torch.ones(4))
    assert torch.equal(rows[:, 3], torch.tensor([0.0, 0, 0, 1]).expand(4, 4))
    assert (rows[0] - rows[1]).abs().max() > 1e-3


def test_the_network_sees_the_pose_but_not_how_the_body_is_turned(bones):
    with torch.no_grad():
        bones.head.weight.normal_(generator=seeded())
    rotations, turned, other = turns(), turns(), turns()
    turned[0] = axis_angle_to_matrix(torch.tensor([0.0, 2.0, 0.0]))
    other[7] = turned[0]
    assert torch.equal(bones(rotations), bones(turned))
    assert not torch.allclose(bones(rotations), bones(other))


def test_translation_is_a_bone_of_its_own_which_turns_nothing(posed, root):
    rotations = turns()
    moved = with_latent_bones(posed(rotations)[None], torch.zeros(0, 4, 4), root)[0]
    assert moved.shape == (JOINTS + 1, 4, 4)
    torch.testing.assert_close(moved[-1, :3, 3], SHIFT)
    assert moved[-1, :3, :3].abs().max() == 0
    torch.testing.assert_close(moved[:-1], posed(rotations, torch.zeros(3)), atol=1e-5, rtol=0)


def test_with_weights_that_sum_to_1_it_is_the_joints_own_blend(posed, root):
    weights = torch.rand(9, JOINTS, generator=seeded())
    weights = weights / weights.sum(1, keepdim=True)
    points, joints = torch.randn(9, 3, generator=seeded(1)), posed(turns())
    moved = with_latent_bones(joints[None], torch.eye(4).expand(2, 4, 4), root)[0]
    with_others = torch.cat([weights, torch.zeros(9, 2), torch.ones(9, 1)], dim=1)
    torch.testing.assert_close(
        transform_points(blend_transforms(with_others, moved), points),
        transform_points(blend_transforms(weights, joints), points),
        atol=1e-5, rtol=0,
    )  # fmt: skip


def test_a_latent_bone_that_stands_still_turns_with_the_body_about_its_root(posed, root):
    moved = with_latent_bones(posed(turns())[None], torch.eye(4)[None], root)[0]
    torch.testing.assert_close(moved[JOINTS], moved[0])
    torch.testing.assert_close(moved[JOINTS, :3, :3] @ root + moved[JOINTS, :3, 3], root)


def test_a_latent_bone_moves_in_the_roots_frame(posed, root):
    shift = torch.eye(4)
    shift[:3, 3] = torch.tensor([0.1, 0.2, 0.3])
    still = with_latent_bones(posed(turns())[None], torch.eye(4)[None], root)[0, JOINTS]
    moved = with_latent_bones(posed(turns())[None], shift[None], root)[0, JOINTS]
    torch.testing.assert_close(moved[:3, 3] - still[:3, 3], turns()[0] @ shift[:3, 3])


def test_instants_do_not_know_of_one_another(posed, root, bones):
    both = torch.stack([posed(turns(1)), posed(turns(2), -SHIFT)])
    moved = bones(turns(3))
    together = with_latent_bones(both, moved, root)
    apart = torch.cat([with_latent_bones(one[None], moved, root) for one in both])
    torch.testing.assert_close(together, apart)


def test_gradients_reach_network_pose_and_transforms_in_double_precision(posed, root):
    torch.manual_seed(1)
    bones = LatentBones(JOINTS, 2, [8]).double()
    angles = 0.3 * torch.randn(JOINTS, 3, generator=seeded(), dtype=torch.float64)
    joints = posed(turns()).double()

    def moved(angles, joints):
        return with_latent_bones(
            joints[None], bones(axis_angle_to_matrix(angles)), root.double()
        ).sum((0, 1))

    assert torch.autograd.gradcheck(moved, (angles.requires_grad_(), joints.requires_grad_()))


def test_the_pose_at_rest_has_a_finite_gradient(bones):
    angles = torch.zeros(JOINTS, 3, requires_grad=True)
    bones(axis_angle_to_matrix(angles)).sum().backward()
    assert torch.isfinite(angles.grad).all()
    assert angles.grad[1:].abs().sum() > 0
