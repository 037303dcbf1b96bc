import dataclasses
import math

import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.bodies.posed_body import (
    joint_transforms,
    posed_joints,
    posed_vertices,
    shaped_joints,
    shaped_vertices,
    vitruvian_transforms,
)
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import skin_points

JOINT = {name: index for index, name in enumerate(SMPL_JOINT_NAMES)}
BETAS = torch.tensor([0.7, -0.4], dtype=torch.float64)


def random_pose(seed=0, batch=()):
    generator = torch.Generator().manual_seed(seed)

    def draw(*size):
        return 0.5 * torch.randn(*batch, *size, generator=generator, dtype=torch.float64)

    return draw(3), draw(23, 3), draw(3)


@pytest.fixture(scope="module")
def supple(body):
    """The capsule body with pose blend shapes."""
    generator = torch.Generator().manual_seed(0)
    shape = (len(body.vertices), 3, 9 * 23)
    return dataclasses.replace(body, pose_dirs=0.01 * torch.randn(*shape, generator=generator))


def test_shape_numbers_add_their_directions(body):
    directions = body.shape_dirs.double()
    expected = body.vertices.double() + 0.7 * directions[..., 0] - 0.4 * directions[..., 1]
    torch.testing.assert_close(shaped_vertices(body, BETAS), expected)
    torch.testing.assert_close(shaped_joints(body, 0 * BETAS), body.joints.double())


def test_the_rest_pose_is_the_shaped_body_moved_by_the_translation(body):
    still, transl = torch.zeros(3).double(), torch.tensor([1.0, 2, 3]).double()
    pose = torch.zeros(23, 3).double()
    vertices = posed_vertices(body, BETAS, still, pose, transl)
    torch.testing.assert_close(vertices, shaped_vertices(body, BETAS) + transl)
    joints = posed_joints(body, BETAS, still, pose, transl)
    torch.testing.assert_close(joints, shaped_joints(body, BETAS) + transl)


def test_the_whole_body_turns_about_its_pelvis(body):
    _, pose, transl = random_pose()
    still, turned = torch.zeros(3).double(), torch.tensor([0.3, -1.0, 0.2]).double()
    pelvis = shaped_joints(body, BETAS)[0] + transl
    before = posed_vertices(body, BETAS, still, pose, transl) - pelvis
    after = posed_vertices(body, BETAS, turned, pose, transl) - pelvis
    torch.testing.assert_close(after, before @ axis_angle_to_matrix(turned).T)


def test_bones_keep_their_lengths_in_every_pose(body):
    rest, posed = shaped_joints(body, BETAS), posed_joints(body, BETAS, *random_pose())
    above = [max(parent, 0) for parent in body.parents]
    torch.testing.assert_close((posed - posed[above]).norm(dim=1), (rest - rest[above]).norm(dim=1))


def test_a_bent_elbow_moves_the_forearm_alone(body):
    still, pose = torch.zeros(3).double(), torch.zeros(23, 3).double()
    pose[JOINT["left_elbow"] - 1, 1] = -math.pi / 2  # forwards: +X turns towards +Z
    joints = posed_joints(body, BETAS, still, pose, still)
    moved = (joints - shaped_joints(body, BETAS)).norm(dim=1) > 1e-6
    assert {name for name, index in JOINT.items() if moved[index]} == {"left_wrist", "left_hand"}
    forearm = joints[JOINT["left_wrist"]] - joints[JOINT["left_elbow"]]
    assert forearm[2] > 0.9 * forearm.norm()


def test_pose_blend_shapes_act_on_rotations_minus_the_identity_before_skinning(supple):
    orient, pose, transl = random_pose()
    feature = torch.cat([(axis_angle_to_matrix(row) - torch.eye(3)).flatten() for row in pose])
    directions = supple.pose_dirs.double()
    offsets = torch.stack(
        [sum(feature[d] * directions[:, c, d] for d in range(len(feature))) for c in range(3)], 1
    )
    transforms = joint_transforms(supple, BETAS, orient, pose, transl)
    weights = supple.lbs_weights.double()
    expected = skin_points(shaped_vertices(supple, BETAS) + offsets, weights, transforms)
    torch.testing.assert_close(posed_vertices(supple, BETAS, orient, pose, transl), expected)


def test_a_batch_is_each_of_its_poses(supple):
    poses = random_pose(batch=(3,))
    together = posed_vertices(supple, BETAS, *poses)
    for index in range(3):
        alone = posed_vertices(supple, BETAS, *(value[index] for value in poses))
        torch.testing.assert_close(together[index], alone)


def test_the_canonical_pose_opens_the_legs_outwards_by_45_degrees_and_moves_nothing_else(body):
    transforms = vitruvian_transforms(body, BETAS)
    rest = shaped_joints(body, BETAS)
    joints = (transforms[:, :3, :3] @ rest[..., None])[..., 0] + transforms[:, :3, 3]
    for side, outwards in (("left", 1), ("right", -1)):
        before = rest[JOINT[f"{side}_ankle"]] - rest[JOINT[f"{side}_hip"]]
        after = joints[JOINT[f"{side}_ankle"]] - joints[JOINT[f"{side}_hip"]]
        angle = torch.atan2(after[0], -after[1]) - torch.atan2(before[0], -before[1])
        assert angle.item() == pytest.approx(outwards * math.pi / 4)
    legs = {JOINT[f"{s}_{j}"] for s in ("left", "right") for j in ("hip", "knee", "ankle", "foot")}
    others = [index for index in range(24) if index not in legs]
    torch.testing.assert_close(transforms[others], torch.eye(4).double().expand(16, 4, 4))


def test_gradients_reach_shape_and_pose(supple):
    few = dataclasses.replace(
        supple, vertices=supple.vertices[:3], shape_dirs=supple.shape_dirs[:3],
        pose_dirs=supple.pose_dirs[:3], lbs_weights=supple.lbs_weights[:3], faces=supple.faces[:0],
    )  # fmt: skip
    inputs = [value.requires_grad_() for value in (BETAS.clone(), *random_pose())]
    assert torch.autograd.gradcheck(lambda *given: posed_vertices(few, *given), inputs)
    assert torch.autograd.gradcheck(lambda *given: posed_joints(few, *given), inputs)
