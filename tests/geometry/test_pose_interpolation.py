"""Poses at other times lie evenly between those that are known."""

import math

import pytest
import torch

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.geometry.pose_interpolation import interpolated

KNOWN = torch.tensor([0.0, 1.0, 3.0, 4.0])


def moving(times: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Joints that turn, and a place that moves, evenly in time."""
    turns = torch.zeros(len(times), 2, 3)
    turns[:, 0, 1], turns[:, 1, 0] = 0.4 * times, -0.1 * times
    return turns, times[:, None] * torch.tensor([1.0, -2.0, 0.5])


def test_even_motion_is_found_again_at_uneven_times():
    wanted = torch.tensor([0.25, 1.0, 2.5, 3.9, 0.0, 4.0])
    found, expected = interpolated(*moving(KNOWN), KNOWN, wanted), moving(wanted)
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, atol=1e-5, rtol=0)


def test_nobody_moves_before_the_first_time_and_after_the_last():
    found, known = interpolated(*moving(KNOWN), KNOWN, torch.tensor([-3.0, 9.0])), moving(KNOWN)
    for one, other in zip(found, known, strict=True):
        torch.testing.assert_close(one, other[[0, -1]])


def test_one_pose_is_all_poses():
    known = moving(torch.tensor([2.0]))
    found = interpolated(*known, torch.tensor([2.0]), torch.tensor([1.0, 2.0, 5.0]))
    for one, other in zip(found, known, strict=True):
        torch.testing.assert_close(one, other.expand(3, *other.shape[1:]))


def test_rotations_take_the_shorter_way_round():
    turns, transl = torch.zeros(2, 1, 3), torch.zeros(2, 3)
    turns[0, 0, 1], turns[1, 0, 1] = 3.0, -3.0
    found, _ = interpolated(turns, transl, torch.tensor([0.0, 3.0]), torch.tensor([1.0]))
    assert float(found[0, 0, 1]) == pytest.approx(3.0 + (2 * math.pi - 6.0) / 3, abs=1e-4)


def test_times_of_eight_bytes_leave_poses_of_four():
    turns, transl = moving(KNOWN)
    poses = Poses(
        betas=torch.zeros(2), global_orient=turns[:, 0], body_pose=turns[:, 1:], transl=transl
    )
    found = poses.at_times(KNOWN.double(), torch.tensor([0.5], dtype=torch.float64))
    assert found.transl.dtype == found.body_pose.dtype == torch.float32
    assert found.transl[0].tolist() == pytest.approx([0.5, -1.0, 0.25])
    assert float(found.global_orient[0, 1]) == pytest.approx(0.2, abs=1e-5)
