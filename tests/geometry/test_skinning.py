import pytest
import torch

from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.geometry.skinning import (
    blend_transforms,
    forward_kinematics,
    invert_rigid,
    skin_points,
)

PARENTS = (-1, 0, 1, 0, 3)
JOINTS = torch.tensor([[0.0, 1, 0], [0, 2, 0], [0, 3, 0], [1, 1, 0], [2, 1, 0]]).double()


def random_rotations(seed=0, batch=()):
    generator = torch.Generator().manual_seed(seed)
    return axis_angle_to_matrix(torch.randn(*batch, 5, 3, generator=generator, dtype=torch.float64))


def one_by_one(rotations, joints, transl):
    """The textbook loop: each joint's transform is its parent's times its own."""
    world = []
    for joint, parent in enumerate(PARENTS):
        local = torch.eye(4).double()
        local[:3, :3] = rotations[joint]
        local[:3, 3] = joints[joint] - (joints[parent] if parent >= 0 else 0)
        world.append(local if parent < 0 else world[parent] @ local)
    result = []
    for joint, matrix in enumerate(world):
        back = torch.eye(4).double()
        back[:3, 3] = -joints[joint]
        moved = matrix @ back
        moved[:3, 3] += transl
        result.append(moved)
    return torch.stack(result)


def test_levels_of_the_tree_give_what_a_loop_over_joints_gives():
    rotations, transl = random_rotations(), torch.tensor([0.1, -0.2, 0.3]).double()
    torch.testing.assert_close(
        forward_kinematics(rotations, JOINTS, transl, PARENTS),
        one_by_one(rotations, JOINTS, transl),
    )


def test_a_batch_is_each_of_its_poses():
    rotations, transl = random_rotations(batch=(4,)), torch.zeros(4, 3).double()
    together = forward_kinematics(rotations, JOINTS, transl, PARENTS)
    for index in range(4):
        alone = forward_kinematics(rotations[index], JOINTS, transl[index], PARENTS)
        torch.testing.assert_close(together[index], alone)


def test_the_rest_pose_moves_nothing():
    still = torch.eye(3).double().expand(5, 3, 3)
    transforms = forward_kinematics(still, JOINTS, torch.zeros(3).double(), PARENTS)
    torch.testing.assert_close(transforms, torch.eye(4).double().expand(5, 4, 4))


def test_moving_the_whole_body_moves_every_point_with_it():
    points = torch.randn(7, 3).double()
    weights = torch.rand(7, 5).double()
    weights /= weights.sum(1, keepdim=True)
    rotations, shift = random_rotations(), torch.tensor([1.0, 2, 3]).double()
    here = forward_kinematics(rotations, JOINTS, torch.zeros(3).double(), PARENTS)
    there = forward_kinematics(rotations, JOINTS, shift, PARENTS)
    torch.testing.assert_close(
        skin_points(points, weights, there), skin_points(points, weights, here) + shift
    )


def test_a_point_of_one_joint_follows_that_joint():
    weights = torch.eye(5).double()
    transforms = forward_kinematics(random_rotations(), JOINTS, torch.zeros(3).double(), PARENTS)
    torch.testing.assert_close(blend_transforms(weights, transforms), transforms)


def test_inverting_twice_changes_nothing_and_once_undoes():
    transforms = forward_kinematics(random_rotations(), JOINTS, torch.ones(3).double(), PARENTS)
    identity = torch.eye(4).double().expand(5, 4, 4)
    torch.testing.assert_close(invert_rigid(transforms) @ transforms, identity)


def test_gradients_reach_rotations_joints_and_translation():
    weights = torch.full((2, 5), 0.2).double()
    points = torch.randn(2, 3).double()

    def skinned(axis_angle, joints, transl):
        rotations = axis_angle_to_matrix(axis_angle)
        return skin_points(points, weights, forward_kinematics(rotations, joints, transl, PARENTS))

    inputs = [torch.randn(5, 3).double(), JOINTS.clone(), torch.zeros(3).double()]
    assert torch.autograd.gradcheck(skinned, [value.requires_grad_() for value in inputs])


def test_a_child_before_its_parent_is_refused():
    with pytest.raises(ValueError, match="parents must come first"):
        forward_kinematics(torch.eye(3).expand(2, 3, 3), torch.zeros(2, 3), torch.zeros(3), (1, -1))
