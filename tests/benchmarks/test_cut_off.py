"""The benchmark of people who are cut off: where the edge is, and what is measured of legs."""

import pytest
import torch

from benchmarks.cut_off import edge_row, leg_degrees
from benchmarks.hands_and_head import RING, SIZE
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.geometry.cameras import project
from deblur_avatar.sources.studio.cameras import place_cameras

FRAMES = 4


def joints(body, knee: float = 0.0):
    pose = torch.zeros(FRAMES, 23, 3)
    pose[:, body.joint_names.index("left_knee") - 1, 0] = knee
    still = torch.zeros(FRAMES, 3)
    betas = torch.zeros(body.shape_dirs.shape[2])
    return posed(body, Poses(betas=betas, global_orient=still, body_pose=pose, transl=still)).joints


def test_the_edge_is_as_far_from_hips_to_knees_as_asked(body):
    cameras = place_cameras(2, SIZE, RING)
    standing = joints(body)
    rows = project(standing, cameras.Ks[0], cameras.viewmats[0])[0][0, :, 1]
    hip, knee = (float(rows[body.joint_names.index(f"left_{name}")]) for name in ("hip", "knee"))
    assert edge_row(standing, body, cameras, 0.0) == pytest.approx(hip, abs=1)
    assert edge_row(standing, body, cameras, 1.0) == pytest.approx(knee, abs=1)
    assert edge_row(standing, body, cameras, 0.25) == pytest.approx(0.75 * hip + 0.25 * knee, abs=1)


def test_legs_are_measured_bone_by_bone_wherever_they_are(body):
    away = leg_degrees(body, joints(body, 0.5) + 0.3, joints(body))
    expected = torch.tensor([0.0, 28.65, 0.0, 0.0]).expand(FRAMES, -1)  # left shin
    torch.testing.assert_close(away, expected, atol=0.3, rtol=0)
