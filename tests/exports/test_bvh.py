"""BVH, read by bvhio and by the project's own reader."""

import dataclasses

import numpy as np
import pytest
import torch

from deblur_avatar.animation.motion_files import read_motion
from deblur_avatar.bodies.posed_body import posed, posed_joints
from deblur_avatar.config.reading import parse
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.bvh import depth_first
from deblur_avatar.exports.registry import ExportParams
from deblur_avatar.exports.shown_motion import even_motion
from deblur_avatar.exports.upright import upright_of
from deblur_avatar.motion.frame import FixedMotion
from tests.exports.requirement import imported


def exporter(motion):
    options = {"format": "bvh", "motion": motion, "fps": 25.0, "seconds": 1.0}
    return parse(ExportParams, options, "export")


@pytest.mark.parametrize("name", ["own", "builtin:jumping_jacks"])
def test_another_programs_reader_finds_every_joint_where_it_is(rough, fitted_run, tmp_path, name):
    bvhio = imported("bvhio")
    run = fitted_run(rough())
    exporter(name).export(run, tmp_path / "a.bvh")
    motion, rate = even_motion(run, name, 25.0, 1.0)
    wanted = upright_of(run).points(posed(run.observations.body, motion.poses).joints)
    hierarchy = bvhio.readAsHierarchy(str(tmp_path / "a.bvh"))
    step = bvhio.readAsBvh(str(tmp_path / "a.bvh")).FrameTime
    assert step == pytest.approx(1 / rate, abs=1e-7)
    for frame in (0, len(motion.times) - 1):
        hierarchy.loadPose(frame)
        found = {joint.Name: joint.PositionWorld for joint, _, _ in hierarchy.layout()}
        names = run.observations.body.joint_names
        read = np.array([[found[n].x, found[n].y, found[n].z] for n in names]) / 100
        np.testing.assert_allclose(read, wanted[frame], atol=1e-5)


def test_the_avatar_can_be_driven_by_its_own_file(rough, fitted_run, body, tmp_path):
    run = fitted_run(rough())
    exporter("builtin:jumping_jacks").export(run, tmp_path / "a.bvh")
    motion, _ = even_motion(run, "builtin:jumping_jacks", 25.0, 1.0)
    betas = run.avatar.betas
    read = read_motion(str(tmp_path / "a.bvh"), body, betas, fps=25.0, start=0.0, seconds=1.0)
    here = upright_of(run).points(posed(body, motion.poses).joints)
    there = posed_joints(body, betas, read.global_orient, read.body_pose, read.transl)
    knees, elbows = [4, 5], [18, 19]
    for joints in (knees, elbows):
        moved = (here - here[:, :1])[:, joints]
        again = (there - there[:, :1])[:, joints]
        torch.testing.assert_close(again, moved, atol=0.03, rtol=0)


def test_uneven_frames_become_even(rough, fitted_run, tmp_path):
    run = fitted_run(rough())
    times = torch.tensor([0.0, 0.1, 0.15, 0.3, 0.4])
    run = dataclasses.replace(run, motion=dataclasses.replace(run.motion, timestamps=times))
    exporter("own").export(run, tmp_path / "a.bvh")
    rows = (tmp_path / "a.bvh").read_text().splitlines()
    assert rows[rows.index("MOTION") + 2] == "Frame Time: 0.10000000"
    angles = np.array([row.split() for row in rows[-5:]], float)
    shoulder = np.abs(np.diff(angles[:, 6:], axis=0)).argmax() % (angles.shape[1] - 6) + 6
    # Fitted at 0, 0.1, 0.15, 0.3 and 0.4 s, 35 degrees each: at 0.2 s a third of the way.
    steps = np.diff(angles[:, shoulder])
    np.testing.assert_allclose(steps, [35, 35 + 35 / 3, 70 / 3, 35], atol=1e-3)
    np.testing.assert_allclose(np.diff(angles[:, 0]), [0.5, 2 / 3, 1 / 3, 0.5], atol=1e-4)


def test_a_hierarchy_is_named_depth_first():
    assert depth_first((-1, 0, 0, 1, 2, 3)) == [0, 1, 3, 5, 2, 4]


def test_one_frame_is_no_motion(rough, fitted_run, swinging, tmp_path):
    run = fitted_run(rough())
    one = FixedMotion(swinging(1, 8.0)).to_artifact(run.avatar.betas, torch.zeros(1))
    with pytest.raises(ConfigError, match="one frame has no frame rate"):
        exporter("own").export(dataclasses.replace(run, motion=one), tmp_path / "a.bvh")
