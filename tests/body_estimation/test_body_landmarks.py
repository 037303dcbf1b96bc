import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.bodies.posed_body import (
    joint_transforms,
    posed_joints,
    shaped_joints,
)
from deblur_avatar.body_estimation.body_landmarks import TORSO, landmark_map
from tests.walking_person import walking_poses

LIMBS = {
    11: "left_shoulder", 12: "right_shoulder", 13: "left_elbow", 14: "right_elbow",
    15: "left_wrist", 16: "right_wrist", 23: "left_hip", 24: "right_hip", 25: "left_knee",
    26: "right_knee", 27: "left_ankle", 28: "right_ankle",
}  # fmt: skip


def resting(body: Body) -> torch.Tensor:
    still = torch.zeros(1, 3)
    pose = torch.zeros(1, len(body.parents) - 1, 3)
    return joint_transforms(body, torch.zeros(body.shape_dirs.shape[2]), still, pose, still)


def test_a_limbs_landmarks_are_its_joints_in_every_pose(body: Body):
    poses, marks = walking_poses(body, 5), landmark_map()
    motion = poses.betas, poses.global_orient, poses.body_pose, poses.transl
    joints = shaped_joints(body, poses.betas)
    positions = marks.positions(joint_transforms(body, *motion), joints, marks.offsets)
    posed = posed_joints(body, *motion)
    for landmark, name in LIMBS.items():
        difference = (
            positions[:, marks.rows.index(landmark)] - posed[:, SMPL_JOINT_NAMES.index(name)]
        )
        assert difference.abs().max() < 1e-5, name


def test_the_right_side_mirrors_the_left(body: Body):
    marks = landmark_map()
    offsets = marks.offsets + torch.tensor([0.01, 0.02, 0.03])
    rest = marks.positions(resting(body), body.joints, offsets)[0]
    for row, landmark in enumerate(marks.rows):
        if landmark and landmark % 2:  # left ones are odd
            other = rest[marks.rows.index(landmark + 1)]
            assert torch.allclose(rest[row], other * torch.tensor([-1.0, 1, 1]), atol=1e-5)


def test_the_nose_is_in_front_of_the_head_and_the_toes_in_front_of_the_heels(body: Body):
    marks = landmark_map()
    positions = marks.positions(resting(body), body.joints, marks.offsets)[0]
    rest = dict(zip(marks.rows, positions, strict=True))
    assert rest[0][2] > rest[7][2] + 0.05
    assert rest[31][2] > rest[29][2] + 0.05


def test_the_torso_is_among_the_landmarks_used():
    marks = landmark_map()
    assert {landmark for landmark, _ in TORSO} <= set(marks.rows)
    assert len(set(marks.rows)) == len(marks.rows)
