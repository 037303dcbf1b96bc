import dataclasses

import pytest
import torch

from deblur_avatar.animation.stage import stage_of_clip
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports import exporter
from deblur_avatar.exports.posed_gaussians import posed_frame
from deblur_avatar.exports.registry import ExportParams
from deblur_avatar.exports.upright import rest_pelvis, upright_of
from deblur_avatar.geometry.cameras import look_at
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from deblur_avatar.motion.frame import FixedMotion
from deblur_avatar.rendering.covariances import covariances

# From +Y up to +Z up, and somewhere else.
TURN = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
SHIFT = torch.tensor([2.0, -3.0, 1.0])


def in_another_world(run):
    """The same person, film and camera, in a world that lies otherwise."""
    pelvis = rest_pelvis(run)
    poses = run.motion.centre
    turned = dataclasses.replace(
        poses,
        global_orient=matrix_to_axis_angle(TURN @ axis_angle_to_matrix(poses.global_orient)),
        transl=(pelvis + poses.transl) @ TURN.T + SHIFT - pelvis,
    )
    cameras = run.observations.cameras
    viewmats = cameras.viewmats.clone()
    viewmats[:, :3, :3] = viewmats[:, :3, :3] @ TURN.T
    viewmats[:, :3, 3] -= viewmats[:, :3, :3] @ SHIFT
    observations = dataclasses.replace(
        run.observations, poses=turned, cameras=dataclasses.replace(cameras, viewmats=viewmats)
    )
    motion = FixedMotion(turned).to_artifact(poses.betas, run.motion.timestamps)
    return dataclasses.replace(run, motion=motion, observations=observations)


def test_turning_the_world_changes_nothing(rough, fitted_run):
    here = fitted_run(rough())
    there = in_another_world(here)
    ours, theirs = (upright_of(run).gaussians(posed_frame(run, 3)) for run in (here, there))
    torch.testing.assert_close(theirs.means, ours.means, atol=2e-6, rtol=0)
    torch.testing.assert_close(
        covariances(theirs.quats, theirs.scales), covariances(ours.quats, ours.scales),
        atol=1e-7, rtol=1e-3,
    )  # fmt: skip
    for part, again in zip(
        *(upright_of(run).pose(run.motion.centre, rest_pelvis(run)) for run in (here, there)),
        strict=True,
    ):
        flipped = (part * again).sum(-1, keepdim=True).sign() if part.shape[-1] == 4 else 1
        torch.testing.assert_close(again * flipped, part, atol=2e-6, rtol=0)


def test_the_person_stands_on_the_floor_faces_the_camera_and_is_the_right_way_up(rough, fitted_run):
    run = in_another_world(fitted_run(rough()))
    axes = upright_of(run)
    joints = axes.points(posed(run.observations.body, run.motion.centre).joints)
    assert float(joints[..., 1].min()) == pytest.approx(0, abs=1e-6)
    assert float(joints[:, 15, 1].min()) > 1.4  # the head
    pelvis = joints[:, 0].mean(0)
    torch.testing.assert_close(pelvis[[0, 2]], torch.zeros(2), atol=1e-6, rtol=0)
    viewmat = run.observations.camera.viewmat
    eye = axes.points(-viewmat[:3, :3].T @ viewmat[:3, 3])
    assert float(eye[2]) > 3
    assert float(joints[0, 20, 0]) > 0.3  # the left wrist is where +X is


def test_a_camera_above_the_head_leaves_no_front(rough, fitted_run):
    run = fitted_run(rough())
    pelvis = posed(run.observations.body, run.motion.centre).joints[:, 0].mean(0)
    above = look_at(pelvis + torch.tensor([0.0, 4.0, 0.0]), pelvis, torch.tensor([0.0, 0.0, 1.0]))
    cameras = dataclasses.replace(run.observations.cameras, viewmats=above[None])
    run = dataclasses.replace(
        run, observations=dataclasses.replace(run.observations, cameras=cameras)
    )
    with pytest.raises(ConfigError, match="no side is in front"):
        upright_of(run)


def test_one_stage_serves_all_that_is_written_of_a_run(rough, fitted_run, monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(
        exporter, "stage_of_clip", lambda *of: asked.append(of) or stage_of_clip(*of)
    )
    run = fitted_run(rough())
    for options in ({"format": "npz"}, {"format": "ply", "frame": 0}):
        path = tmp_path / options["format"]
        parse(ExportParams, options, "export").export(run, path)
    upright_of(run)
    assert len(asked) == 1
