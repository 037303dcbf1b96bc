import dataclasses

import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.body_estimation.track_smoothness import measure_track


def walking(body: Body, speed: float = 1.0) -> Poses:
    """Straight ahead at so many metres a second, ten frames a second."""
    place = torch.zeros(8, 3)
    place[:, 2] = speed * torch.arange(8) / 10
    joints = len(body.parents) - 1
    return Poses(
        betas=torch.zeros(body.shape_dirs.shape[2]),
        global_orient=torch.zeros(8, 3),
        body_pose=torch.zeros(8, joints, 3),
        transl=place,
    )


TIMES = torch.arange(8) / 10


def test_an_even_walk_has_a_ratio_of_one(body: Body):
    track = measure_track(body, walking(body), TIMES)
    assert track["speed_ratio"] == pytest.approx(1, abs=1e-4)
    assert track["fastest_m_s"] == pytest.approx(1, abs=1e-4)


def test_a_jump_is_found_where_it_is(body: Body):
    poses = walking(body)
    place = poses.transl.clone()
    place[4:, 2] += 0.4  # five times the way of a step
    track = measure_track(body, dataclasses.replace(poses, transl=place), TIMES)
    assert track["speed_ratio"] == pytest.approx(5, abs=1e-3)
    assert track["step"] == 3


def test_a_gap_in_time_is_no_jump(body: Body):
    times = torch.tensor([0.0, 0.1, 0.2, 0.3, 0.8, 0.9, 1.0, 1.1])
    poses = walking(body)
    place = torch.zeros(8, 3)
    place[:, 2] = times
    track = measure_track(body, dataclasses.replace(poses, transl=place), times)
    assert track["speed_ratio"] == pytest.approx(1, abs=1e-4)


def test_who_stands_does_not_jump(body: Body):
    trembling = walking(body, 0.0).transl.clone()
    trembling[3] += 0.01
    poses = dataclasses.replace(walking(body), transl=trembling)
    assert measure_track(body, poses, TIMES)["speed_ratio"] < 1


def test_three_frames_say_nothing(body: Body):
    assert measure_track(body, walking(body).at([0, 1, 2]), TIMES[:3]) == {}
