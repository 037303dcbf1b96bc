import pytest
import torch

from deblur_avatar.animation.captured_motion import captured_motion
from deblur_avatar.animation.showing import plan_shot
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.motion.frame import FixedMotion
from tests.animation.turning_person import CAMERA_WORLD, K, in_camera_world, stage_before, standing


@pytest.mark.parametrize(("pitch", "roll"), [(-23, 0), (-19, 14), (-13, -22), (10, 0)])
def test_who_is_shown_to_the_camera_that_is_the_world_stands_upright(body, filmed, pitch, roll):
    filmed = in_camera_world(filmed, pitch, roll)
    stage = stage_before(body, filmed, CAMERA_WORLD)
    shot = plan_shot(
        standing(), body, filmed.betas, stage, K, CAMERA_WORLD,
        size=64, margin=0.1, turns=0.5, travel=0.0,
    )  # fmt: skip
    shown = axis_angle_to_matrix(shot.poses.global_orient)[..., 1]
    torch.testing.assert_close(shown, stage.up.expand_as(shown), atol=1e-4, rtol=0)
    in_picture = shown @ shot.camera.viewmat[:3, :3].T
    torch.testing.assert_close(in_picture[:, 0], torch.zeros(len(shown)), atol=1e-4, rtol=0)


def test_who_is_shown_as_filmed_leans_as_filmed(body, filmed):
    """Fitted poses may lean otherwise than those that the stage is of."""
    stage = stage_before(body, in_camera_world(filmed, -20), CAMERA_WORLD)
    fitted = in_camera_world(filmed, -28, 4)
    motion = FixedMotion(fitted).to_artifact(filmed.betas, torch.arange(20) / 10)
    shot = plan_shot(
        captured_motion(motion, stage, 10.0, 0.0, 9.0), body, filmed.betas, stage, K, CAMERA_WORLD,
        size=64, margin=0.1, turns=0.7, travel=0.0,
    )  # fmt: skip
    was, shown = (
        axis_angle_to_matrix(poses.global_orient)[..., 1] @ stage.up
        for poses in (fitted, shot.poses)
    )
    torch.testing.assert_close(shown, was, atol=1e-4, rtol=0)
