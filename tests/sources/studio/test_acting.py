import math

import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.posed_body import posed_vertices
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.sources.studio.acting import Act, learn, missing_motion
from deblur_avatar.sources.studio.motion import Moves, move

FPS = 60.0
TIMES = torch.arange(24, dtype=torch.float64) / FPS
SECONDS = 24 / FPS
JACKS = "builtin:jumping_jacks"


def done(body: Body, motion: str, times: torch.Tensor = TIMES, **changes: float) -> Moves:
    asked = {"start": 0.0, "turns": 0.0, "seconds": SECONDS} | changes
    betas = torch.zeros(body.shape_dirs.shape[2])
    return learn(Act(motion, **asked), body, betas)(times, SECONDS)


def vertices(body: Body, moves: Moves) -> torch.Tensor:
    betas = torch.zeros(body.shape_dirs.shape[2]).double()
    return posed_vertices(body, betas, moves.global_orient, moves.body_pose, moves.transl)


@pytest.fixture
def swung(tmp_path):
    """An AMASS file of two seconds: an arm swings, the root walks two metres."""
    frames, rate = 240, 120.0
    poses = np.zeros((frames, 156))
    poses[:, 50] = np.sin(np.arange(frames) / rate * 2 * math.pi)
    trans = np.zeros((frames, 3))
    trans[:, 0] = np.linspace(0, 2, frames)
    trans[:, 2] = 7.0
    path = tmp_path / "swing.npz"
    np.savez(path, poses=poses, trans=trans, mocap_framerate=rate)
    return path


def test_a_motion_of_the_studio_is_itself(body: Body):
    own, acted = move("turn", TIMES, SECONDS), done(body, "turn")
    assert torch.equal(own.body_pose, acted.body_pose)
    assert torch.equal(own.transl, acted.transl)
    assert torch.equal(own.global_orient, acted.global_orient)


def test_turns_are_added_about_the_vertical_through_the_middle(body: Body):
    straight, turned = done(body, "walk"), done(body, "walk", turns=0.5)
    angle = math.pi * TIMES / SECONDS
    around = axis_angle_to_matrix(torch.stack([0 * angle, angle, 0 * angle], -1))
    expected = vertices(body, straight) @ around.transpose(1, 2)
    torch.testing.assert_close(vertices(body, turned), expected, atol=1e-6, rtol=0)


def test_another_motion_stands_on_the_floor_in_the_middle(body: Body, swung):
    for name in (JACKS, str(swung)):
        seen = vertices(body, done(body, name))
        assert float(seen[..., 1].min()) == pytest.approx(0, abs=0.01)
        assert seen.mean((0, 1))[[0, 2]].abs().max() < 0.1


def test_a_file_s_path_over_the_floor_stays_about_the_middle(body: Body, swung):
    path = done(body, str(swung)).transl[:, 0]
    assert float(path[-1] - path[0]) == pytest.approx(23 / FPS, abs=0.02)  # a metre a second
    assert float(path.mean()) == pytest.approx(0, abs=0.03)


def test_a_file_is_sampled_smoothly_between_its_frames(body: Body, swung):
    fine = torch.arange(200, dtype=torch.float64) / 960
    pose = done(body, str(swung), fine).body_pose
    joint, axis = divmod(50 - 3, 3)
    torch.testing.assert_close(
        pose[:, joint, axis], torch.sin(2 * math.pi * fine), atol=1e-4, rtol=0
    )


def test_a_start_leaves_out_what_was_before(body: Body, swung):
    late = done(body, str(swung), start=0.5)
    joint, axis = divmod(50 - 3, 3)
    assert float(late.body_pose[0, joint, axis]) == pytest.approx(math.sin(math.pi), abs=1e-4)


def test_a_motion_that_ends_before_the_clip_is_refused(body: Body, swung):
    with pytest.raises(ConfigError, match=r"from 1\.8 s on there are 0\.19 s of motion.*0\.40 s"):
        done(body, str(swung), start=1.8)


def test_a_motion_that_is_not_there_is_refused(body: Body):
    with pytest.raises(ConfigError, match=r"no motion file nowhere\.bvh"):
        done(body, "nowhere.bvh")


def test_what_is_built_in_is_never_missing(swung):
    assert missing_motion("walk", "m") == missing_motion(JACKS, "m") == ()
    assert missing_motion(str(swung), "m") == ()
    assert missing_motion("gone.bvh", "m") == ("no motion file gone.bvh (m)",)
