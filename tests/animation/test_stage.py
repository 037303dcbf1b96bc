import dataclasses
import math

import pytest
import torch

from deblur_avatar.animation.stage import stage_of, stage_of_clip
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.geometry.cameras import look_at
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from tests.animation.turning_person import (
    CAMERA_WORLD,
    PERSON,
    UPRIGHT,
    VIEW,
    in_camera_world,
    stage_before,
)


def test_the_stage_stands_as_the_person_did_and_faces_the_camera(body, filmed):
    rotation = stage_before(body, filmed, VIEW).world_from_stage
    torch.testing.assert_close(rotation.T @ rotation, torch.eye(3), atol=1e-5, rtol=0)
    assert torch.linalg.det(rotation) == pytest.approx(1.0, abs=1e-5)
    assert rotation[2, 1] > 0.999  # up
    expected = torch.nn.functional.normalize(torch.tensor([4.0, 3.0, 0.0]), dim=0)
    torch.testing.assert_close(rotation[:, 2], expected, atol=0.02, rtol=0)


def tilt(pitch):
    """Gravity's opposite in a camera without roll that looks down by `-pitch` degrees."""
    return torch.tensor([0.0, -math.cos(math.radians(pitch)), math.sin(math.radians(pitch))])


def joined(first, second):
    return Poses(
        betas=first.betas,
        **{
            name: torch.cat([getattr(first, name), getattr(second, name)])
            for name in ("global_orient", "body_pose", "transl")
        },
    )


def leaned(filmed, rotation):
    turned = axis_angle_to_matrix(torch.tensor(rotation)) @ axis_angle_to_matrix(
        filmed.global_orient
    )
    return Poses(
        betas=filmed.betas, global_orient=matrix_to_axis_angle(turned),
        body_pose=filmed.body_pose, transl=filmed.transl,
    )  # fmt: skip


def test_who_leans_a_little_all_the_time_still_stands_upright_on_the_stage(body, filmed):
    rotation = stage_before(body, leaned(filmed, [0.35, 0.0, 0.0]), VIEW).world_from_stage
    torch.testing.assert_close(rotation[:, 1], torch.tensor([0.0, 0.0, 1.0]))


def test_in_a_world_without_a_vertical_axis_up_is_where_the_head_was(body, filmed):
    angle = 0.7
    rotation = stage_before(body, leaned(filmed, [angle, 0.0, 0.0]), VIEW).world_from_stage
    up = torch.tensor([0.0, -math.sin(angle), math.cos(angle)])
    torch.testing.assert_close(rotation[:, 1], up, atol=0.04, rtol=0)


@pytest.mark.parametrize("degrees", [-90, -55, 50, 80])
def test_who_lies_sideways_in_the_picture_lies_on_the_stage(body, filmed, degrees):
    towards = VIEW[2, :3]
    lying = leaned(filmed, (math.radians(degrees) * towards).tolist())
    rotation = stage_before(body, lying, VIEW).world_from_stage
    torch.testing.assert_close(rotation[:, 1], torch.tensor([0.0, 0.0, 1.0]))
    tilted = axis_angle_to_matrix(torch.tensor([0.7, 0.0, 0.0]))  # no axis of this world is upright
    view = VIEW.clone()
    view[:3, :3] = VIEW[:3, :3] @ tilted.T
    view[:3, 3] = VIEW[:3, 3]
    lying = leaned(lying, [0.7, 0.0, 0.0])
    up = stage_before(body, lying, view).up
    torch.testing.assert_close(up, -view[1, :3], atol=1e-5, rtol=0)


def degrees_apart(one, other):
    return math.degrees(torch.arccos((one @ other).clamp(-1, 1)))


@pytest.mark.parametrize("lean", [0, -9, 9])
@pytest.mark.parametrize("pitch", [-45, -23, 0, 15, 25])
def test_who_stands_tells_how_far_down_a_camera_looked_that_is_the_world(body, filmed, pitch, lean):
    up = stage_before(body, in_camera_world(filmed, pitch, lean), CAMERA_WORLD).up
    assert up[0] == 0  # people hold cameras level; she leans
    assert degrees_apart(up, tilt(pitch)) < 5


@pytest.mark.parametrize("roll", [-30, -18, 18, 30])
@pytest.mark.parametrize("pitch", [-23, 15])
def test_who_stands_far_aslant_was_filmed_by_a_camera_held_askew(body, filmed, pitch, roll):
    up = stage_before(body, in_camera_world(filmed, pitch, roll), CAMERA_WORLD).up
    rolled = axis_angle_to_matrix(torch.tensor([0.0, 0.0, math.radians(roll)]))
    assert degrees_apart(up, rolled @ tilt(pitch)) < 3


def test_an_axis_of_the_camera_is_no_vertical(body, filmed):
    seen_from_above = in_camera_world(filmed, -23)
    assert stage_before(body, seen_from_above, CAMERA_WORLD).world_from_stage[2, 1] < -0.3
    turned = axis_angle_to_matrix(torch.tensor([0.0, math.radians(1), 0.0]))
    view = CAMERA_WORLD.clone()
    view[:3, :3] = turned
    torch.testing.assert_close(  # a world of its own, and a camera that is almost level
        stage_before(body, seen_from_above, view).up, torch.tensor([0.0, -1.0, 0.0])
    )


@pytest.mark.parametrize(
    ("pitch", "lean"), [(-80, 0), (75, 0), (59, 0), (44, 0), (0, 70), (-20, -60), (-20, 110)]
)
def test_who_lies_before_a_camera_that_is_the_world_lies_on_a_level_stage(
    body, filmed, pitch, lean
):
    up = stage_before(body, in_camera_world(filmed, pitch, lean), CAMERA_WORLD).up
    torch.testing.assert_close(up, torch.tensor([0.0, -1.0, 0.0]))


def test_who_lies_down_now_and_then_stood_for_the_rest(body, filmed):
    stood, lay = in_camera_world(filmed, -20), in_camera_world(filmed, -20, 80)
    few = lay.at(range(15))
    up = stage_before(body, joined(stood, few), CAMERA_WORLD).up
    torch.testing.assert_close(up, stage_before(body, stood, CAMERA_WORLD).up, atol=0.02, rtol=0)
    up = stage_before(body, joined(stood, joined(lay, few)), CAMERA_WORLD).up
    torch.testing.assert_close(up, torch.tensor([0.0, -1.0, 0.0]))


def test_frames_that_contradict_one_another_tell_nothing(body, filmed):
    away, towards = in_camera_world(filmed, 55), in_camera_world(filmed, -55)
    both = joined(away, joined(towards, in_camera_world(filmed, 10)))
    up = stage_before(body, both, CAMERA_WORLD).up
    torch.testing.assert_close(up, torch.tensor([0.0, -1.0, 0.0]))


def test_a_few_wild_frames_do_not_tilt_the_stage(body, filmed):
    wild = joined(in_camera_world(filmed, -20), in_camera_world(filmed, 75).at(range(8)))
    up = stage_before(body, wild, CAMERA_WORLD).up
    assert degrees_apart(up, tilt(-20)) < 6


def bowed(filmed, degrees):
    """The same person, legs as they are, bent at the hips."""
    bend = axis_angle_to_matrix(torch.tensor([math.radians(degrees), 0.0, 0.0]))
    body_pose = filmed.body_pose.clone()
    body_pose[:, [0, 1], 0] = -math.radians(degrees)
    return Poses(
        betas=filmed.betas, body_pose=body_pose, transl=filmed.transl,
        global_orient=matrix_to_axis_angle(axis_angle_to_matrix(filmed.global_orient) @ bend),
    )  # fmt: skip


def test_who_bends_forward_over_the_feet_bends_on_the_stage(body, filmed):
    towards = bowed(in_camera_world(filmed, -20), 40).at([9, 10, 11])
    up = stage_before(body, towards, CAMERA_WORLD).up
    assert degrees_apart(up, tilt(-20)) < 9  # her trunk is 38 degrees off, her neck 14


def test_who_is_filmed_from_above_does_not_lie(body, filmed):
    above = look_at(PERSON + torch.tensor([0.6, 0.0, 4.0]), PERSON, torch.tensor([0.0, 1.0, 0.0]))
    assert stage_before(body, filmed, above).world_from_stage[2, 1] > 0.999


def test_frames_on_the_floor_do_not_tilt_a_world_without_a_vertical_axis(body, filmed):
    stood = leaned(filmed, [0.7, 0.0, 0.0])
    fell = leaned(filmed, (math.radians(70) * VIEW[2, :3]).tolist())
    up = stage_before(body, joined(stood, fell.at(range(12))), VIEW).up
    torch.testing.assert_close(up, stage_before(body, stood, VIEW).up, atol=1e-3, rtol=0)


def test_who_sits_sits_upright_in_a_world_with_a_vertical_axis(body, filmed):
    filmed.body_pose[:, [0, 1], 0] = -math.pi / 2
    filmed.body_pose[:, [3, 4], 0] = math.pi / 3
    sits = filmed.at([6, 7, 8])  # facing the camera, her centre of mass 44 degrees off her soles
    rotation = stage_before(body, sits, VIEW).world_from_stage
    torch.testing.assert_close(rotation[:, 1], torch.tensor([0.0, 0.0, 1.0]))


@pytest.mark.parametrize("degrees", [60, 80])
@pytest.mark.parametrize("frame", range(0, 20, 5))  # every fifth faces along an axis
def test_who_bends_bends_in_a_world_with_a_vertical_axis(body, filmed, frame, degrees):
    bent = bowed(filmed, degrees).at([frame])
    rotation = stage_before(body, bent, VIEW).world_from_stage
    torch.testing.assert_close(rotation[:, 1], torch.tensor([0.0, 0.0, 1.0]))


@pytest.mark.parametrize("frames", [[9, 10, 11], [4, 5, 6], [14, 15, 16]])
def test_who_sits_sits_on_a_level_stage(body, filmed, frames):
    sitting = in_camera_world(filmed, -20)
    sitting.body_pose[:, [0, 1], 0] = -math.pi / 2
    sitting.body_pose[:, [3, 4], 0] = math.pi / 2
    up = stage_before(body, sitting.at(frames), CAMERA_WORLD).up
    assert degrees_apart(up, tilt(-20)) < 6  # her centre of mass is 30 degrees off her soles


@pytest.mark.parametrize("degrees", [-35, 35])
def test_who_is_filmed_from_a_slanting_camera_still_stands(body, filmed, degrees):
    rolled = axis_angle_to_matrix(torch.tensor([0.0, 0.0, math.radians(degrees)]))
    view = VIEW.clone()
    view[:3] = rolled @ VIEW[:3]
    assert stage_before(body, filmed, view).world_from_stage[2, 1] > 0.999


def test_a_camera_above_the_head_has_no_side_in_front(body, filmed):
    above = look_at(PERSON + torch.tensor([0.0, 0, 3]), PERSON, torch.tensor([0.0, 1, 0]))
    straight = Poses(
        betas=filmed.betas, global_orient=matrix_to_axis_angle(UPRIGHT)[None],
        body_pose=filmed.body_pose[:1], transl=PERSON[None],
    )  # fmt: skip
    with pytest.raises(ValueError, match="no side is in front"):
        stage_before(body, straight, above)


def turned_world(filmed, view, turn):
    """The same person and camera in a world of other axes."""
    there = leaned(filmed, turn.tolist())
    there = Poses(
        betas=there.betas, global_orient=there.global_orient, body_pose=there.body_pose,
        transl=there.transl @ axis_angle_to_matrix(turn).T,
    )  # fmt: skip
    moved = view.clone()
    moved[:3, :3] = view[:3, :3] @ axis_angle_to_matrix(turn).T
    return there, moved


@pytest.mark.parametrize(
    ("pitch", "lean"), [(-23, 0), (-20, 18), (15, 0), (0, 70)]
)  # the last one lies
def test_a_world_that_is_another_cameras_tells_as_little_of_up_as_ones_own(
    body, filmed, pitch, lean
):
    filmed = in_camera_world(filmed, pitch, lean)
    own = stage_before(body, filmed, CAMERA_WORLD).up
    turn = torch.tensor([0.1, -1.2, 0.3])
    elsewhere, view = turned_world(filmed, CAMERA_WORLD, turn)
    joints = posed(body, elsewhere).joints
    up = stage_of(joints, view, world_is_a_cameras=True).up
    torch.testing.assert_close(up, axis_angle_to_matrix(turn) @ own, atol=5e-3, rtol=0)


@pytest.mark.parametrize("first_is_the_world", [True, False])
def test_the_stage_of_a_clip_is_of_the_fitted_shape_and_asks_all_cameras_whose_world_it_is(
    body, filmed, make_observations, first_is_the_world
):
    joint_dirs = body.joint_dirs.clone()
    joint_dirs[0, 1, 0] = 0.1  # who is another has another pelvis
    body = dataclasses.replace(body, joint_dirs=joint_dirs)
    observations = dataclasses.replace(make_observations(frames=20), body=body)
    turn = torch.tensor([0.0, 0.05, 0.0])
    seen, view = turned_world(in_camera_world(filmed, -23), CAMERA_WORLD, turn)
    first = CAMERA_WORLD if first_is_the_world else VIEW
    cameras = observations.cameras
    two = {
        name: getattr(cameras, name)[:1].repeat(2, *(1 for _ in getattr(cameras, name).shape[1:]))
        for name in ("Ks", "distortion", "sizes")
    }
    observations = dataclasses.replace(
        observations, poses=seen, train_camera=1, crops=observations.crops[:1].repeat(2, 1),
        cameras=Cameras(viewmats=torch.stack([first, view]), names=("a", "b"), **two),
    )  # fmt: skip
    fitted = torch.tensor([-4.0, 4.0])
    stage = stage_of_clip(observations, fitted)
    joints = posed(body, dataclasses.replace(seen, betas=fitted)).joints
    told = stage_of(joints, view, world_is_a_cameras=first_is_the_world)
    torch.testing.assert_close(stage.world_from_stage, told.world_from_stage)
    torch.testing.assert_close(stage.anchor, joints[:, 0].mean(0))
    assert (degrees_apart(stage.up, -view[1, :3]) > 15) == first_is_the_world
