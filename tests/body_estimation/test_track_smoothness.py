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
SEEN = torch.ones(8, dtype=torch.bool)


def test_an_even_walk_has_a_ratio_of_one(body: Body):
    track = measure_track(body, walking(body), TIMES, SEEN)
    assert track["speed_ratio"] == pytest.approx(1, abs=1e-4)
    assert track["fastest_m_s"] == pytest.approx(1, abs=1e-4)


def test_a_jump_is_found_where_it_is(body: Body):
    poses = walking(body)
    place = poses.transl.clone()
    place[4:, 2] += 0.4  # five times the way of a step
    track = measure_track(body, dataclasses.replace(poses, transl=place), TIMES, SEEN)
    assert track["speed_ratio"] == pytest.approx(5, abs=1e-3)
    assert track["step"] == 3


def test_a_gap_in_time_is_no_jump(body: Body):
    times = torch.tensor([0.0, 0.1, 0.2, 0.3, 0.8, 0.9, 1.0, 1.1])
    poses = walking(body)
    place = torch.zeros(8, 3)
    place[:, 2] = times
    track = measure_track(body, dataclasses.replace(poses, transl=place), times, SEEN)
    assert track["speed_ratio"] == pytest.approx(1, abs=1e-4)


def test_who_stands_does_not_jump(body: Body):
    trembling = walking(body, 0.0).transl.clone()
    trembling[3] += 0.01
    poses = dataclasses.replace(walking(body), transl=trembling)
    assert measure_track(body, poses, TIMES, SEEN)["speed_ratio"] < 1


@pytest.mark.parametrize(("unseen", "ratio"), [((), 5), ((4, 5), 1), ((2,), 1), ((1,), 5)])
def test_steps_to_frames_in_which_nobody_is_seen_are_no_jumps(body: Body, unseen, ratio):
    poses, seen = walking(body), torch.ones(16, dtype=torch.bool)
    seen[list(unseen)] = False
    place = torch.cat([poses.transl, poses.transl + poses.transl[1] + poses.transl[-1]])
    place[4:, 2] += 0.4
    poses = Poses(
        betas=poses.betas, global_orient=torch.zeros(16, 3),
        body_pose=poses.body_pose.repeat(2, 1, 1), transl=place,
    )  # fmt: skip
    track = measure_track(body, poses, torch.arange(16) / 10, seen)
    assert track["speed_ratio"] == pytest.approx(ratio, abs=1e-3)
    assert track["fastest_m_s"] == pytest.approx(5 if 4 not in unseen else 1, abs=1e-3)


def test_three_frames_say_nothing(body: Body):
    assert measure_track(body, walking(body), TIMES, SEEN & (torch.arange(8) % 4 > 0)) == {}
    assert measure_track(body, walking(body).at([0, 1, 2]), TIMES[:3], SEEN[:3]) == {}
