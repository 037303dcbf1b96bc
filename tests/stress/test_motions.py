"""What the person of the stability suite does is what the modes are about."""

import math

import pytest
import torch

from benchmarks.stress.motions import STABILITY_MOTIONS, stability_move
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix

TIMES = torch.arange(0, 449) / 480
SECONDS = 47 / 60


def angles(name, joint):
    moves = stability_move(name, TIMES, SECONDS)
    return axis_angle_to_matrix(moves.body_pose[:, SMPL_JOINT_NAMES.index(joint) - 1])


def speed(rotations):
    """Degrees a second, from one sub-frame to the next."""
    step = rotations[1:] @ rotations[:-1].mT
    trace = step.diagonal(dim1=-1, dim2=-2).sum(-1)
    return torch.rad2deg(torch.acos(((trace - 1) / 2).clamp(-1, 1))) * 480


@pytest.mark.parametrize("name", STABILITY_MOTIONS)
def test_every_motion_is_finite_and_of_the_times_asked_for(name):
    moves = stability_move(name, TIMES, SECONDS)
    for values in [part for part in vars(moves).values() if part is not None]:
        assert len(values) == len(TIMES)
        assert torch.isfinite(values).all()


def test_an_unknown_motion_names_those_there_are():
    with pytest.raises(ConfigError, match="no motion 'walk'; known: turn, "):
        stability_move("walk", TIMES, SECONDS)


def test_forearms_reach_1500_degrees_a_second_and_nothing_else_moves():
    assert float(speed(angles("limbs", "left_elbow")).max()) == pytest.approx(1500, rel=0.02)
    for joint in ("pelvis", "spine3", "left_shoulder", "left_knee"):
        if joint != "pelvis":
            assert float(speed(angles("limbs", joint)).max()) < 1


def test_a_narrow_view_stays_within_its_angle():
    moves = stability_move("narrow_20", TIMES, SECONDS)
    assert float(moves.global_orient.norm(dim=-1).max()) == pytest.approx(
        math.radians(20), rel=1e-3
    )


@pytest.mark.parametrize(("name", "exposures"), [("sine_fast", 1.0), ("triangle_slow", 2.0)])
def test_arms_reverse_once_in_so_many_exposures(name, exposures):
    way = angles(name, "left_shoulder")[:, 1, 0].diff().sign()
    reversals = int((way[1:] != way[:-1]).sum())
    assert reversals == pytest.approx(len(TIMES) / (33 * exposures), abs=2)


def test_a_triangle_moves_at_constant_speed_but_where_it_turns():
    speeds = speed(angles("triangle_slow", "left_shoulder"))
    assert float((speeds > 0.95 * speeds.max()).float().mean()) > 0.9


def test_extreme_poses_are_kept_from_training():
    moves, usual = (stability_move(name, TIMES, SECONDS) for name in ("extremes", "turn"))
    training = TIMES < SECONDS
    torch.testing.assert_close(moves.body_pose[training], usual.body_pose[training])
    hip = SMPL_JOINT_NAMES.index("left_hip") - 1
    assert float(moves.body_pose[~training, hip].norm(dim=-1).max()) > 1.8
