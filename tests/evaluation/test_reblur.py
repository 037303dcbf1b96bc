import dataclasses

import pytest
import torch

from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.evaluation.reblur import poses_of_exposure, reblur, reblurred

TRAIN = (0, 1, 3, 4)


def linear_motion(body, backward: tuple[int, ...] = (), kind: str = "pair") -> Motion:
    """An arm that turns evenly over five frames; some frames have time reversed."""
    u = torch.linspace(0, 1, 3)
    times = torch.arange(5)[:, None] + (u - 0.5)
    for frame in backward:
        times[frame] = times[frame].flip(0)
    joints = len(body.parents)
    body_pose = torch.zeros(5, 3, joints - 1, 3)
    body_pose[:, :, 15, 2] = 0.2 * times
    transl = times[..., None] * torch.tensor([0.05, 0, 0])
    still = torch.zeros(5, 3, 3)
    return Motion(
        kind=kind, u=u, timestamps=torch.arange(5.0),
        num_samples=torch.full((5,), 3), shutter=None, global_orient=still, body_pose=body_pose,
        transl=transl,
        centre=Poses(
            betas=torch.zeros(body.shape_dirs.shape[2]), global_orient=still[:, 1],
            body_pose=body_pose[:, 1], transl=transl[:, 1],
        ),
        parameters={},
    )  # fmt: skip


def test_a_fitted_frame_has_its_own_motion(body):
    motion = linear_motion(body)
    poses = poses_of_exposure(body, motion, 3, TRAIN)
    assert torch.equal(poses.body_pose, motion.body_pose[3])
    assert torch.equal(poses.transl, motion.transl[3])


@pytest.mark.parametrize("backward", [(), (1,), (3,), (1, 3)])
def test_a_frame_between_two_fitted_ones_moves_as_they_do_whatever_their_sense_of_time(
    body, backward
):
    truth = linear_motion(body)
    spoilt = linear_motion(body, backward)
    spoilt.transl[2] = 9  # what a frame that was not fitted holds must not matter
    poses = poses_of_exposure(body, spoilt, 2, TRAIN)
    found = posed(body, poses).joints
    wanted = posed(body, poses_of_exposure(body, truth, 2, (0, 1, 2))).joints
    wanted = wanted.flip(0) if 1 in backward else wanted
    torch.testing.assert_close(found, wanted, atol=1e-5, rtol=0)


def test_beyond_the_last_fitted_frame_its_motion_is_taken(body):
    motion = linear_motion(body)
    poses = poses_of_exposure(body, motion, 4, (0, 1, 3))
    assert torch.equal(poses.transl, motion.transl[3])


def test_a_motion_of_the_whole_clip_knows_every_frame(body):
    motion = linear_motion(body, kind="clip")
    assert torch.equal(poses_of_exposure(body, motion, 2, TRAIN).transl, motion.transl[2])


def test_the_right_avatar_and_motion_explain_what_was_filmed(scene, painted):
    model = painted(frames=8)
    scores = reblur(model, scene.observations, scene.motion)
    assert scores["psnr_train"] > 45  # frames are 8-bit renders of the very model
    assert scores["psnr"] > 40  # the frame set aside lies in the middle of its neighbours
    shifted = scene.motion.transl + torch.tensor([0.2, 0, 0])
    wrong = dataclasses.replace(scene.motion, transl=shifted)
    assert reblur(model, scene.observations, wrong)["psnr_train"] < 25


def test_instants_are_averaged_as_the_shutter_did(scene, painted, body):
    model = painted(frames=8)
    motion = linear_motion(body)
    cameras = scene.observations.cameras
    instants = poses_of_exposure(body, motion, 1, TRAIN)
    images, _ = render_avatar(model, instants, cameras.camera(0), frame=1)
    frames = scene.observations.frames.clone()
    frames[1] = (images.mean(0) * 255).round().to(torch.uint8)
    observations = dataclasses.replace(scene.observations, frames=frames, train=(1,))
    assert reblur(model, observations, motion)["psnr_train"] > 45


def test_an_avatar_is_seen_before_what_was_behind_the_person(scene, painted):
    model, seen = painted(frames=8), scene.observations
    behind = torch.full_like(seen.frames[:1], 180)
    frames = []
    for position in range(len(seen.frames)):
        image, alpha = reblurred(model, seen, scene.motion, position)
        frames.append(image + (1 - alpha)[..., None] * 180 / 255)
    room = (torch.stack(frames) * 255).round().to(torch.uint8)
    filmed = dataclasses.replace(seen, frames=room, backgrounds=behind, averaging_space="srgb")
    assert reblur(model, filmed, scene.motion)["psnr_train"] > 50
    without = dataclasses.replace(filmed, backgrounds=None)
    assert reblur(model, without, scene.motion)["psnr_train"] < 10


def test_without_frames_set_aside_there_is_no_score_for_them(scene, painted):
    observations = dataclasses.replace(scene.observations, validation=())
    assert reblur(painted(frames=8), observations, scene.motion)["psnr"] is None
