import dataclasses

import pytest
import torch

from deblur_avatar.evaluation.instants import pose_at
from tests.evaluation.test_reblur import linear_motion

EXPOSURE = 1.0  # seconds; frames are one apart


def arm(pose) -> float:
    return float(pose.body_pose[0, 15, 2])


@pytest.mark.parametrize("kind", ["pair", "clip"])
@pytest.mark.parametrize("offset", [-0.5, -0.25, 0.0, 0.1, 0.5])
def test_an_instant_lies_on_the_motion_inside_the_exposure(body, kind, offset):
    motion = linear_motion(body, kind=kind)
    pose = pose_at(body, motion, EXPOSURE, 2, offset)
    assert arm(pose) == pytest.approx(0.2 * (2 + offset), abs=1e-6)
    assert float(pose.transl[0, 0]) == pytest.approx(0.05 * (2 + offset), abs=1e-6)


def test_a_frame_fitted_with_time_reversed_is_turned_round(body):
    motion = linear_motion(body, backward=(2,))
    assert arm(pose_at(body, motion, EXPOSURE, 2, 0.25)) == pytest.approx(0.45, abs=1e-6)


def test_a_motion_that_knows_its_sense_of_time_is_left_alone(body):
    motion = linear_motion(body, backward=(2,), kind="clip")
    assert arm(pose_at(body, motion, EXPOSURE, 2, 0.25)) == pytest.approx(0.35, abs=1e-6)


def test_a_motion_of_single_instants_is_interpolated_between_frames(body):
    whole = linear_motion(body)
    motion = dataclasses.replace(
        whole, u=torch.tensor([0.5]), global_orient=whole.global_orient[:, 1:2],
        body_pose=whole.body_pose[:, 1:2], transl=whole.transl[:, 1:2],
    )  # fmt: skip
    motion.centre.body_pose[3] = 0  # the arm falls back at once
    assert arm(pose_at(body, motion, EXPOSURE, 2, -0.25)) == pytest.approx(0.35, abs=1e-6)
    assert arm(pose_at(body, motion, EXPOSURE, 2, 0.25)) == pytest.approx(0.3, abs=1e-6)
    assert arm(pose_at(body, motion, EXPOSURE, 4, 0.25)) == pytest.approx(0.8, abs=1e-6)


def test_beyond_the_shutter_its_end_counts(body):
    motion = linear_motion(body)
    assert arm(pose_at(body, motion, 0.5, 2, 0.4)) == pytest.approx(0.5, abs=1e-6)
