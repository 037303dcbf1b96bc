import dataclasses

import numpy as np
import pytest
import torch

from deblur_avatar.animation.amass import read_amass
from deblur_avatar.animation.captured_motion import captured_motion
from deblur_avatar.bodies.posed_body import posed_joints
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.registry import ExportParams
from deblur_avatar.motion.frame import FixedMotion

EXPORTER = parse(ExportParams, {"format": "npz"}, "export")


def run_of(painted, observations, poses) -> FittedRun:
    motion = FixedMotion(poses).to_artifact(poses.betas, observations.timestamps)
    return FittedRun("capsules-lean", painted().to_artifact(1), motion, observations)


def test_the_file_drives_a_body_as_the_fit_did(painted, observations, swinging, body, tmp_path):
    poses = swinging(5, 30.0)
    poses = dataclasses.replace(poses, global_orient=torch.tensor([[0.1, 0.4, 0.0]]).repeat(5, 1))
    run = run_of(painted, observations, poses)
    EXPORTER.export(run, tmp_path / "motion.npz")
    read = read_amass(tmp_path / "motion.npz")
    assert read.fps == pytest.approx(60, rel=1e-5)
    fitted = captured_motion(run.motion, run.stage, 60.0, 0.0, 1.0)
    betas = poses.betas
    there = posed_joints(body, betas, read.global_orient, read.body_pose, read.transl)
    here = posed_joints(body, betas, fitted.global_orient, fitted.body_pose, fitted.transl)
    hands = [22, 23]  # AMASS's readers leave the hands straight
    keep = [joint for joint in range(24) if joint not in hands]
    torch.testing.assert_close(there[:, keep], here[:, keep], atol=1e-5, rtol=0)


def test_the_file_has_amass_keys_a_licence_and_stands_on_plus_z(
    painted, observations, swinging, tmp_path
):
    EXPORTER.export(run_of(painted, observations, swinging(5, 8.0)), tmp_path / "motion.npz")
    with np.load(tmp_path / "motion.npz", allow_pickle=False) as content:
        assert content["poses"].shape == (5, 72)
        assert content["trans"].shape == (5, 3)
        assert str(content["licence"]) == observations.body.licence
        assert content["betas"].shape == observations.poses.betas.shape
        assert float(content["mocap_framerate"]) == pytest.approx(60, rel=1e-5)
        # Someone upright turns SMPL's +Y to the world's +Z: a quarter turn about X.
        np.testing.assert_allclose(content["poses"][:, :3], [[np.pi / 2, 0, 0]] * 5, atol=0.02)


def test_one_frame_is_no_motion(painted, make_observations, swinging, tmp_path):
    run = run_of(painted, make_observations(frames=5), swinging(5, 8.0))
    motion = FixedMotion(swinging(1, 8.0)).to_artifact(run.avatar.betas, torch.zeros(1))
    with pytest.raises(ConfigError, match="one frame has no frame rate"):
        EXPORTER.export(dataclasses.replace(run, motion=motion), tmp_path / "motion.npz")


def test_a_format_without_a_frame_has_no_such_option():
    with pytest.raises(ConfigError, match="unknown key 'frame'"):
        parse(ExportParams, {"format": "npz", "frame": 1}, "export")
