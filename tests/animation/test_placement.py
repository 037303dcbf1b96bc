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
from deblur_avatar.animation.showing import plan_shot
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed, posed_joints, posed_vertices
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


def test_the_stage_stands_as_the_person_did_and_faces_the_camera(body, filmed):
    rotation = stage_of(body, filmed, VIEW)
    torch.testing.assert_close(rotation.T @ rotation, torch.eye(3), atol=1e-5, rtol=0)
    assert torch.linalg.det(rotation) == pytest.approx(1.0, abs=1e-5)
    assert rotation[2, 1] > 0.999  # up
    expected = torch.nn.functional.normalize(torch.tensor([4.0, 3.0, 0.0]), dim=0)
    torch.testing.assert_close(rotation[:, 2], expected, atol=0.02, rtol=0)


CAMERA_WORLD = torch.eye(4)  # +Y down, +Z away from the camera


def tilt(pitch):
    """Gravity's opposite in a camera without roll that looks down by `-pitch` degrees."""
    return torch.tensor([0.0, -math.cos(math.radians(pitch)), math.sin(math.radians(pitch))])


def in_camera_world(filmed, pitch, lean=0.0):
    """The same person before a camera that looks down by `-pitch`, all leaning sideways."""
    level = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # +Z up to +Y down
    turns = torch.tensor([[math.radians(-pitch), 0, 0], [0, 0, math.radians(lean)]])
    pitched, rolled = axis_angle_to_matrix(turns)
    orient = rolled @ pitched @ level @ axis_angle_to_matrix(filmed.global_orient)
    return Poses(
        betas=filmed.betas, global_orient=matrix_to_axis_angle(orient),
        body_pose=filmed.body_pose, transl=torch.tensor([0.3, 0.2, 5.0]).expand(len(orient), 3),
    )  # fmt: skip


def joined(first, second):
    return Poses(
        betas=first.betas,
        **{
            name: torch.cat([getattr(first, name), getattr(second, name)])
            for name in ("global_orient", "body_pose", "transl")
        },
    )


def stage_of(body, filmed, viewmat):
    return stage_rotation(posed(body, filmed).joints, viewmat)


def leaned(filmed, rotation):
    turned = axis_angle_to_matrix(torch.tensor(rotation)) @ axis_angle_to_matrix(
        filmed.global_orient
    )
    return Poses(
        betas=filmed.betas, global_orient=matrix_to_axis_angle(turned),
        body_pose=filmed.body_pose, transl=filmed.transl,
    )  # fmt: skip


def test_who_leans_a_little_all_the_time_still_stands_upright_on_the_stage(body, filmed):
    rotation = stage_of(body, leaned(filmed, [0.35, 0.0, 0.0]), VIEW)
    torch.testing.assert_close(rotation[:, 1], torch.tensor([0.0, 0.0, 1.0]))


def test_in_a_world_without_a_vertical_axis_up_is_where_the_head_was(body, filmed):
    angle = 0.7
    rotation = stage_of(body, leaned(filmed, [angle, 0.0, 0.0]), VIEW)
    up = torch.tensor([0.0, -math.sin(angle), math.cos(angle)])
    torch.testing.assert_close(rotation[:, 1], up, atol=0.04, rtol=0)


@pytest.mark.parametrize("degrees", [-90, -55, 50, 80])
def test_who_lies_sideways_in_the_picture_lies_on_the_stage(body, filmed, degrees):
    towards = VIEW[2, :3]
    lying = leaned(filmed, (math.radians(degrees) * towards).tolist())
    rotation = stage_of(body, lying, VIEW)
    torch.testing.assert_close(rotation[:, 1], torch.tensor([0.0, 0.0, 1.0]))
    tilted = axis_angle_to_matrix(torch.tensor([0.7, 0.0, 0.0]))  # no axis of this world is upright
    view = VIEW.clone()
    view[:3, :3] = VIEW[:3, :3] @ tilted.T
    view[:3, 3] = VIEW[:3, 3]
    lying = leaned(lying, [0.7, 0.0, 0.0])
    up = stage_of(body, lying, view)[:, 1]
    torch.testing.assert_close(up, -view[1, :3], atol=1e-5, rtol=0)


def degrees_apart(one, other):
    return math.degrees(torch.arccos((one @ other).clamp(-1, 1)))


@pytest.mark.parametrize("lean", [0, -9, 9])
@pytest.mark.parametrize("pitch", [-45, -23, 0, 15, 25])
def test_who_stands_tells_how_far_down_a_camera_looked_that_is_the_world(body, filmed, pitch, lean):
    up = stage_of(body, in_camera_world(filmed, pitch, lean), CAMERA_WORLD)[:, 1]
    assert up[0] == 0  # people hold cameras level; she leans
    assert degrees_apart(up, tilt(pitch)) < 5


@pytest.mark.parametrize("roll", [-30, -18, 18, 30])
@pytest.mark.parametrize("pitch", [-23, 15])
def test_who_stands_far_aslant_was_filmed_by_a_camera_held_askew(body, filmed, pitch, roll):
    up = stage_of(body, in_camera_world(filmed, pitch, roll), CAMERA_WORLD)[:, 1]
    rolled = axis_angle_to_matrix(torch.tensor([0.0, 0.0, math.radians(roll)]))
    assert degrees_apart(up, rolled @ tilt(pitch)) < 3


def test_an_axis_of_the_camera_is_no_vertical(body, filmed):
    seen_from_above = in_camera_world(filmed, -23)
    assert stage_of(body, seen_from_above, CAMERA_WORLD)[2, 1] < -0.3
    turned = axis_angle_to_matrix(torch.tensor([0.0, math.radians(1), 0.0]))
    view = CAMERA_WORLD.clone()
    view[:3, :3] = turned
    torch.testing.assert_close(  # a world of its own, and a camera that is almost level
        stage_of(body, seen_from_above, view)[:, 1], torch.tensor([0.0, -1.0, 0.0])
    )


@pytest.mark.parametrize(
    ("pitch", "lean"), [(-80, 0), (75, 0), (59, 0), (44, 0), (0, 70), (-20, -60), (-20, 110)]
)
def test_who_lies_before_a_camera_that_is_the_world_lies_on_a_level_stage(
    body, filmed, pitch, lean
):
    up = stage_of(body, in_camera_world(filmed, pitch, lean), CAMERA_WORLD)[:, 1]
    torch.testing.assert_close(up, torch.tensor([0.0, -1.0, 0.0]))


def test_who_lies_down_now_and_then_stood_for_the_rest(body, filmed):
    stood, lay = in_camera_world(filmed, -20), in_camera_world(filmed, -20, 80)
    few = lay.at(range(15))
    up = stage_of(body, joined(stood, few), CAMERA_WORLD)[:, 1]
    torch.testing.assert_close(up, stage_of(body, stood, CAMERA_WORLD)[:, 1], atol=0.02, rtol=0)
    up = stage_of(body, joined(stood, joined(lay, few)), CAMERA_WORLD)[:, 1]
    torch.testing.assert_close(up, torch.tensor([0.0, -1.0, 0.0]))


def test_frames_that_contradict_one_another_tell_nothing(body, filmed):
    away, towards = in_camera_world(filmed, 55), in_camera_world(filmed, -55)
    up = stage_of(body, joined(away, joined(towards, in_camera_world(filmed, 10))), CAMERA_WORLD)
    torch.testing.assert_close(up[:, 1], torch.tensor([0.0, -1.0, 0.0]))


def test_a_few_wild_frames_do_not_tilt_the_stage(body, filmed):
    wild = joined(in_camera_world(filmed, -20), in_camera_world(filmed, 75).at(range(8)))
    up = stage_of(body, wild, CAMERA_WORLD)[:, 1]
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
    up = stage_of(body, towards, CAMERA_WORLD)[:, 1]
    assert degrees_apart(up, tilt(-20)) < 9  # her trunk is 38 degrees off, her neck 14


def test_who_is_filmed_from_above_does_not_lie(body, filmed):
    above = look_at(PERSON + torch.tensor([0.6, 0.0, 4.0]), PERSON, torch.tensor([0.0, 1.0, 0.0]))
    assert stage_of(body, filmed, above)[2, 1] > 0.999


def test_frames_on_the_floor_do_not_tilt_a_world_without_a_vertical_axis(body, filmed):
    stood = leaned(filmed, [0.7, 0.0, 0.0])
    fell = leaned(filmed, (math.radians(70) * VIEW[2, :3]).tolist())
    up = stage_of(body, joined(stood, fell.at(range(12))), VIEW)[:, 1]
    torch.testing.assert_close(up, stage_of(body, stood, VIEW)[:, 1], atol=1e-3, rtol=0)


def test_who_sits_sits_upright_in_a_world_with_a_vertical_axis(body, filmed):
    filmed.body_pose[:, [0, 1], 0] = -math.pi / 2
    filmed.body_pose[:, [3, 4], 0] = math.pi / 3
    sits = filmed.at([6, 7, 8])  # facing the camera, her centre of mass 44 degrees off her soles
    rotation = stage_of(body, sits, VIEW)
    torch.testing.assert_close(rotation[:, 1], torch.tensor([0.0, 0.0, 1.0]))


@pytest.mark.parametrize("degrees", [60, 80])
@pytest.mark.parametrize("frame", range(0, 20, 5))  # every fifth faces along an axis
def test_who_bends_bends_in_a_world_with_a_vertical_axis(body, filmed, frame, degrees):
    bent = bowed(filmed, degrees).at([frame])
    rotation = stage_of(body, bent, VIEW)
    torch.testing.assert_close(rotation[:, 1], torch.tensor([0.0, 0.0, 1.0]))


@pytest.mark.parametrize("frames", [[9, 10, 11], [4, 5, 6], [14, 15, 16]])
def test_who_sits_sits_on_a_level_stage(body, filmed, frames):
    sitting = in_camera_world(filmed, -20)
    sitting.body_pose[:, [0, 1], 0] = -math.pi / 2
    sitting.body_pose[:, [3, 4], 0] = math.pi / 2
    up = stage_of(body, sitting.at(frames), CAMERA_WORLD)[:, 1]
    assert degrees_apart(up, tilt(-20)) < 6  # her centre of mass is 30 degrees off her soles


@pytest.mark.parametrize("degrees", [-35, 35])
def test_who_is_filmed_from_a_slanting_camera_still_stands(body, filmed, degrees):
    rolled = axis_angle_to_matrix(torch.tensor([0.0, 0.0, math.radians(degrees)]))
    view = VIEW.clone()
    view[:3] = rolled @ VIEW[:3]
    assert stage_of(body, filmed, view)[2, 1] > 0.999


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
    rotation = stage_of(body, filmed, VIEW)
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


def test_a_camera_above_the_head_has_no_side_in_front(body, filmed):
    above = look_at(PERSON + torch.tensor([0.0, 0, 3]), PERSON, torch.tensor([0.0, 1, 0]))
    straight = Poses(
        betas=filmed.betas, global_orient=matrix_to_axis_angle(UPRIGHT)[None],
        body_pose=filmed.body_pose[:1], transl=PERSON[None],
    )  # fmt: skip
    with pytest.raises(ValueError, match="no side is in front"):
        stage_of(body, straight, above)


def test_a_person_who_walks_behind_the_camera_is_refused():
    points = torch.tensor([[[0.0, 0.0, 1.0], [9.0, 9.0, 2.0]]])
    with pytest.raises(ValueError, match="lower animate.travel"):
        framed_intrinsics(points, K, VIEW, 64, 0.1)


@pytest.mark.parametrize(("pitch", "roll"), [(-23, 0), (-19, 14), (-13, -22), (10, 0)])
def test_who_is_shown_to_the_camera_that_is_the_world_stands_upright(body, filmed, pitch, roll):
    filmed = in_camera_world(filmed, pitch, roll)
    shot = plan_shot(
        standing(), body, filmed, K, CAMERA_WORLD, size=64, margin=0.1, turns=0.5, travel=0.0
    )
    told = stage_of(body, filmed, CAMERA_WORLD)[:, 1]
    shown = axis_angle_to_matrix(shot.poses.global_orient)[..., 1]
    torch.testing.assert_close(shown, told.expand_as(shown), atol=1e-4, rtol=0)
    in_picture = shown @ shot.camera.viewmat[:3, :3].T
    torch.testing.assert_close(in_picture[:, 0], torch.zeros(len(shown)), atol=1e-4, rtol=0)
