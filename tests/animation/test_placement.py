import pytest
import torch

from deblur_avatar.animation.placement import NEAREST, framed_camera, level_view, place
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed_joints, posed_vertices
from deblur_avatar.geometry.cameras import camera_centres, project
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from tests.animation.turning_person import PERSON, VIEW, K, stage_before, standing


@pytest.mark.parametrize("heading", [0.0, 1.0, 3.0, -2.0])
def test_whoever_looks_anywhere_starts_upright_facing_the_camera(body, filmed, heading):
    poses = place(
        standing(heading=heading),
        body,
        filmed.betas,
        stage_before(body, filmed, VIEW),
        turns=0.0,
        travel=0.0,
    )
    joints = posed_joints(body, poses.betas, poses.global_orient, poses.body_pose, poses.transl)
    torch.testing.assert_close(joints[0, 0], PERSON, atol=1e-4, rtol=0)
    pixels, _ = project(joints[0], K, VIEW)
    head, foot, left, right = pixels[15], pixels[7], pixels[18], pixels[19]
    assert head[1] < foot[1]  # rows grow downwards
    assert left[0] > right[0]  # the left hand of who faces us is on our right
    assert abs(left[1] - right[1]) < 0.05 * (foot[1] - head[1])


def test_the_filmed_shape_is_kept(body, filmed):
    poses = place(
        standing(), body, filmed.betas, stage_before(body, filmed, VIEW), turns=0.0, travel=0.0
    )
    assert torch.equal(poses.betas, filmed.betas)


def test_one_turn_shows_the_back_in_the_middle_and_ends_where_it_began(body, filmed):
    poses = place(
        standing(frames=5),
        body,
        filmed.betas,
        stage_before(body, filmed, VIEW),
        turns=1.0,
        travel=0.0,
    )
    turned = axis_angle_to_matrix(poses.global_orient)
    torch.testing.assert_close(turned[0], turned[-1], atol=1e-5, rtol=0)
    torch.testing.assert_close(turned[0, :, 2], -turned[2, :, 2], atol=1e-5, rtol=0)


def test_jumps_stay_and_steps_are_damped(body, filmed):
    path = torch.tensor([[0.0, 0, 0], [1.0, 0.2, 0], [2.0, 0, 1.0]])
    motion = standing(frames=3, transl=path)
    still = place(
        motion, body, filmed.betas, stage_before(body, filmed, VIEW), turns=0.0, travel=0.0
    ).transl
    moved = place(
        motion, body, filmed.betas, stage_before(body, filmed, VIEW), turns=0.0, travel=0.5
    ).transl
    rotation = stage_before(body, filmed, VIEW).world_from_stage
    expected = torch.tensor([[0.0, 0, 0], [0.0, 0.2, 0], [0.0, 0, 0]])
    torch.testing.assert_close((still - still[0]) @ rotation, expected, atol=1e-5, rtol=0)
    expected = torch.tensor([[0.0, 0, 0], [0.5, 0.2, 0], [1.0, 0, 0.5]])
    torch.testing.assert_close((moved - moved[0]) @ rotation, expected, atol=1e-5, rtol=0)


def test_a_lean_against_the_vertical_stays(body, filmed):
    leaning = torch.tensor([[0.5, 0.0, 0.0]])
    poses = place(
        standing(frames=1, global_orient=leaning),
        body,
        filmed.betas,
        stage_before(body, filmed, VIEW),
        turns=0.0,
        travel=0.0,
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
    here = place(
        motion, body, filmed.betas, stage_before(body, filmed, VIEW), turns=0.5, travel=1.0
    )
    there = place(
        motion, body, filmed.betas, stage_before(body, elsewhere, view), turns=0.5, travel=1.0
    )
    seen = [
        project(
            posed_joints(body, p.betas, p.global_orient, p.body_pose, p.transl), K, v
        )[0]
        for p, v in ((here, VIEW), (there, view))
    ]  # fmt: skip
    torch.testing.assert_close(seen[0], seen[1], atol=0.05, rtol=0)


def test_the_frame_holds_the_person_with_its_margin(body, filmed):
    poses = place(
        standing(), body, filmed.betas, stage_before(body, filmed, VIEW), turns=1.0, travel=0.0
    )
    points = posed_vertices(body, poses.betas, poses.global_orient, poses.body_pose, poses.transl)
    framed = framed_camera(points, K, VIEW, 64, 0.1)
    assert torch.equal(framed.viewmat, VIEW)
    pixels = project(points, framed.K, VIEW)[0].reshape(-1, 2)
    low, high = pixels.min(0).values, pixels.max(0).values
    longer = float((high - low).max())
    assert longer == pytest.approx(64 / 1.2, abs=0.1)
    torch.testing.assert_close((low + high) / 2, torch.tensor([32.0, 32.0]), atol=0.1, rtol=0)


def test_a_camera_that_hangs_askew_is_set_upright_where_it_stands(body, filmed):
    roll = torch.eye(4)
    roll[:3, :3] = axis_angle_to_matrix(torch.tensor([0.1, -0.2, 0.5]))
    level = level_view(stage_before(body, filmed, roll @ VIEW), roll @ VIEW)
    torch.testing.assert_close(camera_centres(level), camera_centres(VIEW), atol=1e-4, rtol=0)
    line = torch.stack([PERSON + torch.tensor([0.0, 0, h]) for h in (-0.5, 0.0, 0.5)])
    pixels, _ = project(line, K, level)
    torch.testing.assert_close(pixels[:, 0], K[0, 2].expand(3), atol=0.5, rtol=0)
    assert pixels[0, 1] > pixels[2, 1]
    torch.testing.assert_close(pixels[1], K[:2, 2], atol=0.5, rtol=0)


def near(depths: list[float]) -> torch.Tensor:
    """Points so far before the camera."""
    seen = torch.tensor([[0.1 * index, 0.2, depth] for index, depth in enumerate(depths)])
    inverse = torch.linalg.inv(VIEW)
    return seen @ inverse[:3, :3].T + inverse[:3, 3]


def test_a_camera_that_a_limb_would_touch_steps_straight_back():
    points = near([-0.9, 0.4, 1.5])
    framed = framed_camera(points, K, VIEW, 64, 0.1)
    pixels, depths = project(points, framed.K, framed.viewmat)
    assert depths.min() == pytest.approx(NEAREST, abs=1e-4)
    assert ((pixels > 0) & (pixels < 64)).all()
    assert torch.equal(framed.viewmat[:3, :3], VIEW[:3, :3])
    assert torch.equal(framed.viewmat[:2, 3], VIEW[:2, 3])


def test_a_person_who_walks_past_the_camera_is_refused():
    with pytest.raises(ValueError, match="lower animate.travel"):
        framed_camera(near([-2.0, 0.4, 1.5]), K, VIEW, 64, 0.1)
