import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.centre_of_mass import centre_of_mass
from deblur_avatar.bodies.posed_body import posed


def enclosed_centre(vertices, faces):
    """Centre of the volume that a closed mesh encloses."""
    a, b, c = vertices[faces].unbind(1)
    volumes = (torch.linalg.cross(a, b) * c).sum(1)
    return (volumes[:, None] * (a + b + c) / 4).sum(0) / volumes.sum()


def poses_of(body, body_pose):
    return Poses(
        betas=torch.zeros(body.shape_dirs.shape[2]),
        global_orient=torch.zeros(len(body_pose), 3), body_pose=body_pose,
        transl=torch.zeros(len(body_pose), 3),
    )  # fmt: skip


def test_a_body_of_one_density_has_the_middle_of_its_volume_there(body):
    body_pose = torch.zeros(3, 23, 3)
    body_pose[1, [0, 1], 0] = -1.5  # sits
    body_pose[1, [3, 4], 0] = 1.5
    body_pose[2, 15, 2] = 1.2  # an arm up
    moved = posed(body, poses_of(body, body_pose))
    expected = torch.stack([enclosed_centre(vertices, body.faces) for vertices in moved.vertices])
    torch.testing.assert_close(centre_of_mass(moved.joints), expected, atol=0.05, rtol=0)


def test_the_shares_are_a_whole_body_s():
    joints = torch.full((1, len(SMPL_JOINT_NAMES), 3), 2.0)
    torch.testing.assert_close(centre_of_mass(joints), torch.full((1, 3), 2.0))


@pytest.mark.parametrize(
    ("name", "share"),
    [("head", 0.081), ("left_knee", 0.1 * 0.433 + 0.0465 * 0.567), ("right_hand", 0.006 * 0.506)],
)
def test_a_joint_moves_the_centre_by_its_segments_share(name, share):
    joints = torch.zeros(1, len(SMPL_JOINT_NAMES), 3)
    joints[0, SMPL_JOINT_NAMES.index(name), 1] = 1.0
    torch.testing.assert_close(centre_of_mass(joints), torch.tensor([[0.0, share, 0.0]]))
