import math

import pytest
import torch

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.animation.placement import (
    framed_intrinsics,
    level_view,
    place,
    stage_rotation,
)
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed_joints, posed_vertices
from deblur_avatar.geometry.cameras import (
    camera_centres,
    look_at,
    project,
)
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

PERSON = torch.tensor([1.0, 2.0, 1.1])  # in a world with +Z up
UPRIGHT = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # +Y to +Z
VIEW = look_at(torch.tensor([5.0, 5.0, 1.6]), PERSON, torch.tensor([0.0, 0.0, 1.0]))
K = torch.tensor([[500.0, 0, 300], [0, 500, 200], [0, 0, 1]])


@pytest.fixture
def filmed():
    """Someone who turned round on the spot, leaning forth and back a little."""
    frames = 20
    angle = torch.linspace(0, 6.2832, frames + 1)[:-1]
    lean = 0.2 * torch.sin(3 * angle)
    zero = torch.zeros(frames)
    turned = axis_angle_to_matrix(torch.stack([zero, angle, zero], 1))
    leaned = axis_angle_to_matrix(torch.stack([lean, zero, zero], 1))
    return Poses(
        betas=torch.tensor([1.0, 0.0]),
        global_orient=matrix_to_axis_angle(UPRIGHT @ turned @ leaned),
        body_pose=torch.zeros(frames, 23, 3),
        transl=PERSON.repeat(frames, 1),
    )


def standing(frames=6, heading=0.0, **changes):
    orient = torch.tensor([0.0, heading, 0.0]).repeat(frames, 1)
    content = {
        "fps": 10.0, "global_orient": orient, "body_pose": torch.zeros(frames, 23, 3),
        "transl": torch.zeros(frames, 3),
    }  # fmt: skip
    return BodyMotion(**(content | changes))


def test_the_stage_stands_as_the_person_did_and_faces_the_camera(filmed):
    rotation = stage_rotation(filmed, PERSON, VIEW)
    torch.testing.assert_close(rotation.T @ rotation, torch.eye(3), atol=1e-5, rtol=0)
    assert torch.linalg.det(rotation) == pytest.approx(1.0, abs=1e-5)
    assert rotation[2, 1] > 0.999  # up
    expected = torch.nn.functional.normalize(torch.tensor([4.0, 3.0, 0.0]), dim=0)
    torch.testing.assert_close(rotation[:, 2], expected, atol=0.02, rtol=0)


def leaned(filmed, rotation):
    turned = axis_angle_to_matrix(torch.tensor(rotation)) @ axis_angle_to_matrix(
        filmed.global_orient
    )
    return Poses(
        betas=filmed.betas, global_orient=matrix_to_axis_angle(turned),
        body_pose=filmed.body_pose, transl=filmed.transl,
    )  # fmt: skip


def test_who_leans_a_little_all_the_time_still_stands_upright_on_the_stage(filmed):
    rotation = stage_rotation(leaned(filmed, [0.35, 0.0, 0.0]), PERSON, VIEW)
    torch.testing.assert_close(rotation[:, 1], torch.tensor([0.0, 0.0, 1.0]))


def test_in_a_world_without_a_vertical_axis_up_is_where_the_head_was(filmed):
    angle = 0.7
    rotation = stage_rotation(leaned(filmed, [angle, 0.0, 0.0]), PERSON, VIEW)
    up = torch.tensor([0.0, -math.sin(angle), math.cos(angle)])
    torch.testing.assert_close(rotation[:, 1], up, atol=0.02, rtol=0)


@pytest.mark.parametrize("degrees", [-90, -55, 50, 80])
def test_who_lies_sideways_in_the_picture_lies_on_the_stage(filmed, degrees):
    towards = VIEW[2, :3]
    lying = leaned(filmed, (math.radians(degrees) * towards).tolist())
    rotation = stage_rotation(lying, PERSON, VIEW)
    torch.testing.assert_close(rotation[:, 1], torch.tensor([0.0, 0.0, 1.0]))
    tilted = axis_angle_to_matrix(torch.tensor([0.7, 0.0, 0.0]))  # no axis of this world is upright
    view = VIEW.clone()
    view[:3, :3] = VIEW[:3, :3] @ tilted.T
    view[:3, 3] = VIEW[:3, 3]
    lying = leaned(lying, [0.7, 0.0, 0.0])
    person = tilted @ PERSON
    up = stage_rotation(lying, person, view)[:, 1]
    torch.testing.assert_close(up, -view[1, :3], atol=1e-5, rtol=0)


@pytest.mark.parametrize("degrees", [-35, 35])
def test_who_is_filmed_from_a_slanting_camera_still_stands(filmed, degrees):
    rolled = axis_angle_to_matrix(torch.tensor([0.0, 0.0, math.radians(degrees)]))
    view = VIEW.clone()
    view[:3] = rolled @ VIEW[:3]
    assert stage_rotation(filmed, PERSON, view)[2, 1] > 0.999


@pytest.mark.parametrize("heading", [0.0, 1.0, 3.0, -2.0])
def test_whoever_looks_anywhere_starts_upright_facing_the_camera(body, filmed, heading):
    poses = place(standing(heading=heading), body, filmed, VIEW, turns=0.0, travel=0.0)
    joints = posed_joints(body, poses.betas, poses.global_orient, poses.body_pose, poses.transl)
    torch.testing.assert_close(joints[0, 0], PERSON, atol=1e-4, rtol=0)
    pixels, _ = project(joints[0], K, VIEW)
    head, foot, left, right = pixels[15], pixels[7], pixels[18], pixels[19]
    assert head[1] < foot[1]  # rows grow downwards
    assert left[0] > right[0]  # the left hand of who faces us is on our right
    assert abs(left[1] - right[1]) < 0.05 * (foot[1] - head[1])


def test_the_filmed_shape_is_kept(body, filmed):
    poses = place(standing(), body, filmed, VIEW, turns=0.0, travel=0.0)
    assert torch.equal(poses.betas, filmed.betas)


def test_one_turn_shows_the_back_in_the_middle_and_ends_where_it_began(body, filmed):
    poses = place(standing(frames=5), body, filmed, VIEW, turns=1.0, travel=0.0)
    turned = axis_angle_to_matrix(poses.global_orient)
    torch.testing.assert_close(turned[0], turned[-1], atol=1e-5, rtol=0)
    torch.testing.assert_close(turned[0, :, 2], -turned[2, :, 2], atol=1e-5, rtol=0)


def test_jumps_stay_and_steps_are_damped(body, filmed):
    path = torch.tensor([[0.0, 0, 0], [1.0, 0.2, 0], [2.0, 0, 1.0]])
    motion = standing(frames=3, transl=path)
    still = place(motion, body, filmed, VIEW, turns=0.0, travel=0.0).transl
    moved = place(motion, body, filmed, VIEW, turns=0.0, travel=0.5).transl
    rotation = stage_rotation(filmed, PERSON, VIEW)
    expected = torch.tensor([[0.0, 0, 0], [0.0, 0.2, 0], [0.0, 0, 0]])
    torch.testing.assert_close((still - still[0]) @ rotation, expected, atol=1e-5, rtol=0)
    expected = torch.tensor([[0.0, 0, 0], [0.5, 0.2, 0], [1.0, 0, 0.5]])
    torch.testing.assert_close((moved - moved[0]) @ rotation, expected, atol=1e-5, rtol=0)


def test_a_lean_against_the_vertical_stays(body, filmed):
    leaning = torch.tensor([[0.5, 0.0, 0.0]])
    poses = place(
        standing(frames=1, global_orient=leaning), body, filmed, VIEW, turns=0.0, travel=0.0
    )
    up = axis_angle_to_matrix(poses.global_orient)[0, :, 1]
    assert up[2] == pytest.approx(torch.cos(torch.tensor(0.5)).item(), abs=0.01)


def test_moving_world_and_camera_together_moves_the_result_with_them(body, filmed):
    rotation = axis_angle_to_matrix(torch.tensor([torch.pi / 2, 0.0, 0.0]))  # axis to axis
    shift = torch.tensor([0.5, -2.0, 1.0])
    rest = body.joints[0] + body.joint_dirs[0] @ filmed.betas
    elsewhere = Poses(
        betas=filmed.betas,
        global_orient=matrix_to_axis_angle(rotation @ axis_angle_to_matrix(filmed.global_orient)),
        body_pose=filmed.body_pose,
        transl=(filmed.transl + rest) @ rotation.T + shift - rest,
    )
    view = VIEW.clone()
    view[:3, :3] = VIEW[:3, :3] @ rotation.T
    view[:3, 3] = VIEW[:3, 3] - view[:3, :3] @ shift
    motion = standing(frames=3, transl=torch.rand(3, 3, generator=torch.Generator().manual_seed(0)))
    here = place(motion, body, filmed, VIEW, turns=0.5, travel=1.0)
    there = place(motion, body, elsewhere, view, turns=0.5, travel=1.0)
    seen = [
        project(
            posed_joints(body, p.betas, p.global_orient, p.body_pose, p.transl), K, v
        )[0]
        for p, v in ((here, VIEW), (there, view))
    ]  # fmt: skip
    torch.testing.assert_close(seen[0], seen[1], atol=0.05, rtol=0)


def test_the_frame_holds_the_person_with_its_margin(body, filmed):
    poses = place(standing(), body, filmed, VIEW, turns=1.0, travel=0.0)
    points = posed_vertices(body, poses.betas, poses.global_orient, poses.body_pose, poses.transl)
    framed = framed_intrinsics(points, K, VIEW, 64, 0.1)
    pixels = project(points, framed, VIEW)[0].reshape(-1, 2)
    low, high = pixels.min(0).values, pixels.max(0).values
    longer = float((high - low).max())
    assert longer == pytest.approx(64 / 1.2, abs=0.1)
    torch.testing.assert_close((low + high) / 2, torch.tensor([32.0, 32.0]), atol=0.1, rtol=0)


def test_a_camera_that_hangs_askew_is_set_upright_where_it_stands(body, filmed):
    roll = torch.eye(4)
    roll[:3, :3] = axis_angle_to_matrix(torch.tensor([0.1, -0.2, 0.5]))
    level = level_view(body, filmed, roll @ VIEW)
    torch.testing.assert_close(camera_centres(level), camera_centres(VIEW), atol=1e-4, rtol=0)
    line = torch.stack([PERSON + torch.tensor([0.0, 0, h]) for h in (-0.5, 0.0, 0.5)])
    pixels, _ = project(line, K, level)
    torch.testing.assert_close(pixels[:, 0], K[0, 2].expand(3), atol=0.5, rtol=0)
    assert pixels[0, 1] > pixels[2, 1]
    torch.testing.assert_close(pixels[1], K[:2, 2], atol=0.5, rtol=0)


def test_a_camera_above_the_head_has_no_side_in_front(filmed):
    above = look_at(PERSON + torch.tensor([0.0, 0, 3]), PERSON, torch.tensor([0.0, 1, 0]))
    straight = Poses(
        betas=filmed.betas, global_orient=matrix_to_axis_angle(UPRIGHT)[None],
        body_pose=filmed.body_pose[:1], transl=PERSON[None],
    )  # fmt: skip
    with pytest.raises(ValueError, match="no side is in front"):
        stage_rotation(straight, PERSON, above)


def test_a_person_who_walks_behind_the_camera_is_refused():
    points = torch.tensor([[[0.0, 0.0, 1.0], [9.0, 9.0, 2.0]]])
    with pytest.raises(ValueError, match="lower animate.travel"):
        framed_intrinsics(points, K, VIEW, 64, 0.1)
