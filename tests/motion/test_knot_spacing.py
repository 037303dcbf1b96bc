"""Knots stand closer together where the given poses move faster than they could follow."""

import dataclasses
import logging

import pytest
import torch

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.motion.knot_spacing import choose_spacing

FPS = 60.0
TIMES = torch.arange(72) / FPS
FRAME = 1 / FPS
SEEN = torch.ones(len(TIMES), dtype=torch.bool)


def swinging(period_s: float, degrees: float = 60.0, noise_degrees: float = 0.0) -> Poses:
    """One elbow swings; every joint is wrong by smooth noise of its own."""
    generator = torch.Generator().manual_seed(1)
    body_pose = torch.zeros(len(TIMES), 23, 3)
    swing = torch.deg2rad(torch.tensor(degrees)) * torch.sin(2 * torch.pi * TIMES / period_s)
    body_pose[:, 17, 1] = swing
    noise = torch.randn(len(TIMES) + 8, 23, 3, generator=generator)
    noise = torch.nn.functional.avg_pool1d(noise.permute(1, 2, 0), 9, 1).permute(2, 0, 1) * 3
    return Poses(
        betas=torch.zeros(10),
        global_orient=torch.zeros(len(TIMES), 3),
        body_pose=body_pose + torch.deg2rad(torch.tensor(noise_degrees)) * noise,
        transl=torch.zeros(len(TIMES), 3),
    )


def frames(
    poses: Poses, coarsest: float = 4.0, finest: float = 1.0, seen: torch.Tensor = SEEN
) -> float:
    spacing = choose_spacing(poses, TIMES, seen, coarsest * FRAME, finest * FRAME, 0.1, 0.035)
    return round(spacing / FRAME, 3)


@pytest.mark.parametrize(("period_s", "wanted"), [(2.0, 4.0), (0.25, 2.0), (0.13, 1.0)])
def test_faster_swings_take_closer_knots(period_s, wanted):
    assert frames(swinging(period_s)) == wanted


def test_errors_of_the_given_poses_take_none():
    assert frames(swinging(2.0, noise_degrees=1.5)) == 4.0


def test_knots_are_never_closer_than_allowed():
    assert frames(swinging(0.13), finest=2.0) == 2.0
    assert frames(swinging(0.13), coarsest=4.0, finest=4.0) == 4.0


def test_what_was_chosen_is_said(caplog):
    with caplog.at_level(logging.INFO):
        frames(swinging(0.25))
    assert "knots every 33.3 ms predict poses" in caplog.text


@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_few_frames_choose_without_failing(count):
    poses = swinging(0.25).at(slice(0, count))
    spacing = choose_spacing(poses, TIMES[:count], SEEN[:count], 4 * FRAME, FRAME, 0.1, 0.035)
    assert spacing >= FRAME * 0.999


def test_the_sign_of_a_quaternion_is_no_motion():
    poses = swinging(2.0)
    turned = torch.linspace(2.5, 4.5, len(TIMES))  # through half a turn, where signs flip
    orient = torch.stack([0 * turned, turned, 0 * turned], 1)
    assert frames(dataclasses.replace(poses, global_orient=orient)) == 4.0


def test_frames_in_which_nobody_is_seen_have_no_say():
    poses = swinging(0.25, degrees=25.0)
    still, moved = poses.body_pose.clone(), torch.arange(len(TIMES)) < len(TIMES) // 6
    still[~moved] = 0  # most of the frames
    assert frames(dataclasses.replace(poses, body_pose=still)) == 4.0
    assert frames(dataclasses.replace(poses, body_pose=still), seen=moved) == 2.0
    assert frames(poses, seen=~SEEN) == 4.0
