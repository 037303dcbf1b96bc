import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.bodies.posed_body import posed_joints
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.sources.studio.motion import (
    MOTIONS,
    Moves,
    _moves,
    move,
)

TRAINING = 80 / 60  # seconds, as in params.yaml


def sampled(name: str, rate: float = 960.0, seconds: float = 1.6) -> tuple[torch.Tensor, Moves]:
    times = torch.arange(round(rate * seconds), dtype=torch.float64) / rate
    return times, move(name, times, TRAINING)


def speeds(body: Body, moves: Moves, rate: float) -> torch.Tensor:
    betas = torch.zeros(body.shape_dirs.shape[2], dtype=torch.float64)
    joints = posed_joints(body, betas, moves.global_orient, moves.body_pose, moves.transl)
    return rate * joints.diff(dim=0).norm(dim=-1)


def test_standing_still_does_not_move():
    _, moves = sampled("still")
    for pose in (moves.global_orient, moves.body_pose, moves.transl):
        assert (pose - pose[:1]).abs().max() == 0


def test_a_turn_shows_every_side_in_the_training_part():
    times, moves = sampled("turn")
    facing = axis_angle_to_matrix(moves.global_orient)[:, :, 2]
    yaw = torch.atan2(facing[:, 0], facing[:, 2])[times < TRAINING]
    turned = torch.remainder(yaw.diff() + torch.pi, 2 * torch.pi) - torch.pi
    assert abs(yaw[0]) < 0.1  # the face first
    assert turned.sum() == pytest.approx(2 * torch.pi, abs=0.15)
    assert turned.min() > 0


def test_the_feet_fly_at_three_to_eight_metres_a_second(body: Body):
    times, moves = sampled("turn")
    speed = speeds(body, moves, 960.0)
    training = times[1:] < TRAINING
    for side in ("left", "right"):
        peak = speed[training, SMPL_JOINT_NAMES.index(f"{side}_ankle")].max()
        assert 3 < peak < 8
    assert speed[:, SMPL_JOINT_NAMES.index("left_wrist")].max() > 3


@pytest.mark.parametrize("name", MOTIONS)
def test_motion_is_smooth(name: str, body: Body):
    # Halving the step halves what the velocity changes by from one step to the next.
    changes = []
    for rate in (480.0, 960.0):
        _, moves = sampled(name, rate)
        betas = torch.zeros(body.shape_dirs.shape[2], dtype=torch.float64)
        joints = posed_joints(body, betas, moves.global_orient, moves.body_pose, moves.transl)
        changes.append(float((rate * joints.diff(dim=0)).diff(dim=0).norm(dim=-1).max()))
    assert changes[1] <= 0.55 * changes[0] + 1e-9


def test_the_held_out_part_shows_poses_of_its_own():
    times, moves = sampled("turn", rate=60.0)
    pose = axis_angle_to_matrix(moves.body_pose)
    training, held_out = pose[times < TRAINING], pose[times > TRAINING + 0.15]
    for wanted in held_out:
        cosine = ((training * wanted).sum((-1, -2)) - 1) / 2
        degrees = torch.rad2deg(torch.acos(cosine.clamp(-1, 1))).mean(1)
        assert 2 < degrees.min() < 25  # new, but not absurd


def test_a_pose_depends_on_its_time_alone():
    times = torch.tensor([0.1, 0.9])
    together, alone = move("turn", times, TRAINING), move("turn", times[1:], TRAINING)
    torch.testing.assert_close(together.body_pose[1:], alone.body_pose)


def test_turns_about_several_axes_are_made_in_the_order_given():
    quarter = torch.full((1,), torch.pi / 2).double()
    turns = {"left_shoulder": [(2, -quarter), (0, -quarter)]}  # lower the arm, then raise it ahead
    moves = _moves(turns, [], torch.zeros(1, 3).double())
    shoulder = axis_angle_to_matrix(moves.body_pose[0, SMPL_JOINT_NAMES.index("left_shoulder") - 1])
    arm = shoulder @ torch.tensor([1.0, 0, 0]).double()
    torch.testing.assert_close(arm, torch.tensor([0.0, 0, 1]).double())
    assert moves.global_orient.abs().max() == 0


def test_an_unknown_motion_is_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match="no motion 'waltz'; known: turn, still"):
        move("waltz", torch.zeros(1), 1.0)
