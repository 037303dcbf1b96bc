"""The benchmark of people who squat, sit, lie and lean: they do so on the floor, seen sideways."""

import pytest
import torch

from benchmarks.exercises import CYCLE, EXERCISES, exercising, mean_of
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.bodies.posed_body import posed

TIMES = torch.linspace(0, CYCLE, 9)


def joints_and_vertices(body, name):
    betas = torch.zeros(body.shape_dirs.shape[2])
    moves = exercising(body, betas, name, TIMES, phase=0.0)
    found = posed(body, moves.poses(betas))
    by_name = dict(zip(SMPL_JOINT_NAMES, found.joints.unbind(1), strict=True))
    return by_name, found.vertices


@pytest.mark.parametrize("name", EXERCISES)
def test_she_touches_the_floor_in_every_frame_and_does_it_again(body, name):
    joints, vertices = joints_and_vertices(body, name)
    torch.testing.assert_close(vertices[..., 1].amin(1), torch.zeros(len(TIMES)), atol=1e-4, rtol=0)
    again = [joint[-1] - joint[0] for joint in joints.values()]
    assert torch.stack(again)[:, 1].abs().max() < 1e-3
    turned = joints["left_hip"] - joints["right_hip"]
    assert turned[:, 2].abs().min() > 0.05  # seen sideways
    assert (turned[:, 0] < -0.1).all() == (name == "crossed_behind")  # her left is on the left


def test_squats_lower_the_pelvis_and_push_ups_the_shoulders(body):
    squats, push_ups = (joints_and_vertices(body, name)[0] for name in ("squats", "push_ups"))
    middle = len(TIMES) // 2
    assert squats["pelvis"][middle, 1] < 0.75 * squats["pelvis"][0, 1]
    assert push_ups["left_shoulder"][middle, 1] < push_ups["left_shoulder"][0, 1] - 0.03
    lying = push_ups["head"][0] - push_ups["left_ankle"][0]
    assert lying[1].abs() < 0.4 * lying.norm()


def test_sit_ups_raise_the_head_from_the_floor(body):
    joints, _ = joints_and_vertices(body, "sit_ups")
    middle = len(TIMES) // 2
    assert joints["head"][0, 1] < 0.5 * joints["head"][middle, 1]
    assert (joints["left_knee"][:, 1] > joints["left_hip"][:, 1]).all()
    assert (joints["left_knee"][:, 1] > joints["left_ankle"][:, 1]).all()


@pytest.mark.parametrize(("name", "axis", "sign"), [("sideways", 0, 1), ("behind", 2, -1)])
def test_crossed_arms_are_before_the_chest_which_turns_away_from_the_camera(body, name, axis, sign):
    joints, _ = joints_and_vertices(body, f"crossed_{name}")
    width = (joints["left_shoulder"] - joints["right_shoulder"]).norm(dim=-1)
    apart = (joints["left_wrist"] - joints["right_wrist"]).norm(dim=-1)
    assert (apart < 0.5 * width).all()
    before = joints["left_wrist"] - joints["spine3"]
    assert (sign * before[:, axis] > 0.2).all()


def test_means_are_of_each_number_of_a_table_wherever_it_stands():
    takes = [
        {"found": 1.0, 0.5: {"a": 1.0}},
        {"found": 0.5, 0.5: {"a": 2.0}},
        {"found": 0.5, 0.5: {"a": 2.0}},
    ]
    assert mean_of(takes, 2) == {"found": 0.67, "0.5": {"a": 1.67}}
    assert mean_of(takes[:1], 1) == {"found": 1.0, "0.5": {"a": 1.0}}
