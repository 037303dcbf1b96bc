import math

import pytest
import torch

from benchmarks.hands_and_head import BENT, FINGERS, PARTS, degrees_apart, gesturing, summary
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.geometry.rotations import axis_angle_to_matrix


def test_angles_are_those_between_rotations():
    turns = axis_angle_to_matrix(torch.tensor([[[0.0, 0.3, 0.0], [0.0, 0.0, 0.0]]]))
    still = torch.eye(3).expand(1, 2, 3, 3)
    assert degrees_apart(turns, still)[0].tolist() == pytest.approx(
        [math.degrees(0.3), 0], abs=1e-3
    )
    assert torch.allclose(degrees_apart(turns, turns), torch.zeros(1, 2), atol=0.1)


def test_fingers_of_both_hands_bend_towards_their_palms():
    moves = gesturing(torch.Generator().manual_seed(0), torch.arange(48) / 24.0)
    left, right = (
        moves.body_pose[:, SMPL_JOINT_NAMES.index(name) - 1, 2] for name in FINGERS.values()
    )
    assert torch.allclose(left, -right)
    assert -BENT <= left.min() < -0.9 * BENT
    assert left.max() <= 0


def test_means_are_over_all_people_and_over_where_a_part_was_found():
    """Two people, of one frame and of two; only the second one's left hand is found, once."""
    joint = SMPL_JOINT_NAMES.index(PARTS["left hand"])

    def take(frames: int, whole: list[float], detail: list[float], found: list[float]):
        errors = torch.zeros(2, frames, len(SMPL_JOINT_NAMES))
        errors[0, :, joint], errors[1, :, joint] = torch.tensor(whole), torch.tensor(detail)
        seen = torch.zeros(frames, 3)
        seen[:, 0] = torch.tensor(found)
        return {"found": seen, "whole body": errors[0], "in detail": errors[1]}

    rows = summary([take(1, [30.0], [30.0], [0.0]), take(2, [60.0, 90.0], [10.0, 20.0], [0.9, 0])])
    assert rows["left hand"] == {
        "found": 0.333,
        "whole body": {"all": 60.0, "where found": 60.0},
        "in detail": {"all": 20.0, "where found": 10.0},
    }
    assert rows["right hand"]["in detail"] == {"all": 0.0, "where found": None}
    assert rows["left fingers"]["found"] == 0.333
