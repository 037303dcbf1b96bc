import dataclasses
import math

import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.evaluation.motion_errors import (
    pose_errors,
    travel_errors,
)

FRAMES, EXPOSURE = 4, 0.05
LEFT_SHOULDER = 15  # row of body_pose
ARM = [18, 20, 22]  # joints beyond the left shoulder


def standing(body: Body, frames: int = FRAMES) -> Poses:
    generator = torch.Generator().manual_seed(0)
    joints = len(body.parents)
    return Poses(
        betas=torch.zeros(body.shape_dirs.shape[2]),
        global_orient=0.3 * torch.randn(frames, 3, generator=generator),
        body_pose=0.2 * torch.randn(frames, joints - 1, 3, generator=generator),
        transl=torch.randn(frames, 3, generator=generator),
    )


def moved(poses: Poses, **changes: torch.Tensor) -> Poses:
    return dataclasses.replace(poses, **changes)


def swing(body: Body, times: torch.Tensor) -> Poses:
    """A left arm that turns at 4 radians a second, on a body that slides at 1 m/s."""
    joints = len(body.parents)
    body_pose = torch.zeros(len(times), joints - 1, 3)
    body_pose[:, LEFT_SHOULDER, 2] = 4 * times
    return Poses(
        betas=torch.zeros(body.shape_dirs.shape[2]),
        global_orient=torch.zeros(len(times), 3),
        body_pose=body_pose,
        transl=times[:, None] * torch.tensor([1.0, 0, 0]),
    )


def motion_of(body: Body, timestamps: torch.Tensor, u: torch.Tensor, backward: bool) -> Motion:
    """The true motion at instants `u`, forward in time or backward."""
    order = u.flip(0) if backward else u
    times = timestamps[:, None] + (order - 0.5) * EXPOSURE
    poses = swing(body, times.flatten())
    shape = times.shape
    return Motion(
        kind="pair",
        u=u,
        timestamps=timestamps,
        num_samples=torch.full((len(timestamps),), len(u)),
        shutter=None,
        global_orient=poses.global_orient.reshape(*shape, 3),
        body_pose=poses.body_pose.reshape(*shape, -1, 3),
        transl=poses.transl.reshape(*shape, 3),
        centre=swing(body, timestamps),
        parameters={},
    )


def errors_of(body: Body, motion: Motion) -> dict[str, float | None]:
    times = torch.linspace(-0.1, 0.5, 601)
    return travel_errors(
        body, motion, EXPOSURE, list(range(len(motion.timestamps))), times, swing(body, times)
    )


def test_equal_poses_have_no_error(body):
    errors = pose_errors(body, standing(body), standing(body))
    assert errors == pytest.approx(dict.fromkeys(errors, 0.0), abs=1e-4)
    assert set(errors) == {"joint_error_mm", "surface_error_mm", "joint_error_deg"}


def test_a_shift_of_a_centimetre_is_ten_millimetres_everywhere(body):
    true = standing(body)
    errors = pose_errors(body, moved(true, transl=true.transl + torch.tensor([0, 0.01, 0])), true)
    assert errors["joint_error_mm"] == pytest.approx(10, abs=1e-3)
    assert errors["surface_error_mm"] == pytest.approx(10, abs=1e-3)
    assert errors["joint_error_deg"] == pytest.approx(0, abs=1e-4)


def test_one_joint_turned_by_ten_degrees_counts_as_a_share_of_all(body):
    true = standing(body)
    still = torch.zeros_like(true.body_pose)
    turned = still.clone()
    turned[:, LEFT_SHOULDER, 2] = math.radians(10)
    errors = pose_errors(body, moved(true, body_pose=turned), moved(true, body_pose=still))
    assert errors["joint_error_deg"] == pytest.approx(10 / 24, rel=1e-4)
    joints = posed(body, moved(true, body_pose=still)).joints
    reach = (joints[0, ARM] - joints[0, 16]).norm(dim=-1)
    chord = 2 * math.sin(math.radians(5)) * reach.sum()
    assert errors["joint_error_mm"] == pytest.approx(1e3 * float(chord) / 24, rel=1e-3)


def test_errors_do_not_depend_on_where_the_world_has_its_origin(body):
    true = standing(body)
    wrong = moved(true, body_pose=true.body_pose + 0.05)
    shift = torch.tensor([3.0, -2.0, 1.0])
    there = pose_errors(
        body, moved(wrong, transl=wrong.transl + shift), moved(true, transl=true.transl + shift)
    )
    assert there == pytest.approx(pose_errors(body, wrong, true), rel=1e-4)


@pytest.mark.parametrize("u", [torch.linspace(0, 1, 5), (torch.arange(5) + 0.5) / 5])
def test_the_true_motion_has_no_travel_error_however_it_is_sampled(body, u):
    motion = motion_of(body, torch.tensor([0.1, 0.2, 0.3]), u, backward=False)
    errors = errors_of(body, motion)
    assert errors["travel_error_mm"] == pytest.approx(0, abs=0.1)
    assert errors["direction_accuracy"] == 1


def test_time_reversed_is_forgiven_by_the_travel_and_counted_by_the_direction(body):
    motion = motion_of(body, torch.tensor([0.1, 0.2]), torch.linspace(0, 1, 3), backward=True)
    errors = errors_of(body, motion)
    assert errors["travel_error_mm"] == pytest.approx(0, abs=0.1)
    assert errors["direction_accuracy"] == 0


def test_a_body_held_still_misses_all_of_the_travel(body):
    timestamps = torch.tensor([0.2])
    motion = motion_of(body, timestamps, torch.tensor([0.5]), backward=False)
    errors = errors_of(body, motion)
    ends = posed(body, swing(body, torch.tensor([0.175, 0.225]))).joints
    travel = (ends[1] - ends[0]).norm(dim=-1).mean()
    assert errors["travel_error_mm"] == pytest.approx(1e3 * float(travel), rel=1e-3)
    assert errors["travel_error_mm"] > 50  # 1 m/s for 50 ms, and the arm
    assert errors["direction_accuracy"] is None


def test_half_the_motion_is_half_the_travel_wrong(body):
    whole = motion_of(body, torch.tensor([0.2]), torch.linspace(0, 1, 3), backward=False)
    slide = swing(body, torch.tensor([0.1875, 0.2, 0.2125]))  # half as long
    motion = dataclasses.replace(whole, body_pose=slide.body_pose[None], transl=slide.transl[None])
    still = motion_of(body, torch.tensor([0.2]), torch.tensor([0.5]), backward=False)
    assert errors_of(body, motion)["travel_error_mm"] == pytest.approx(
        errors_of(body, still)["travel_error_mm"] / 2, rel=0.01
    )


def test_only_the_frames_asked_for_count(body):
    timestamps = torch.tensor([0.1, 0.2])
    motion = motion_of(body, timestamps, torch.linspace(0, 1, 3), backward=False)
    spoilt = motion.transl.clone()
    spoilt[1] *= -3
    spoilt = dataclasses.replace(motion, transl=spoilt)
    times = torch.linspace(-0.1, 0.5, 601)
    good = travel_errors(body, spoilt, EXPOSURE, [0], times, swing(body, times))
    bad = travel_errors(body, spoilt, EXPOSURE, [1], times, swing(body, times))
    assert good["travel_error_mm"] < 0.1
    assert bad["travel_error_mm"] > 10


def test_joints_that_hardly_move_have_no_direction(body):
    timestamps = torch.tensor([0.2])
    motion = motion_of(body, timestamps, torch.linspace(0, 1, 3), backward=False)
    times = torch.linspace(-0.1, 0.5, 601)
    slow = swing(body, times / 100)
    assert travel_errors(body, motion, EXPOSURE, [0], times, slow)["direction_accuracy"] is None
