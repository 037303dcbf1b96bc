import dataclasses

import numpy as np
import pytest
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.render import as_filmed
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.evaluation import avatar_measures
from deblur_avatar.evaluation.avatar_measures import (
    MARGIN,
    SIDES,
    coverage_iou,
    explained_share,
    far_share,
    filmed_looks,
    outside_share,
    own_explained_share,
    parts_inside,
    turntable,
)
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    matrix_to_quat,
    quat_multiply,
    quat_to_axis_angle,
)

TRAIN = [0, 1, 2, 3]


def displaced(avatar, share: float, metres: float):
    """The avatar with the last share of its Gaussians moved sideways."""
    moved = round(share * len(avatar.gaussians))
    with torch.no_grad():
        avatar.gaussians.means[-moved:, 0] += metres
    return avatar


def test_an_avatar_on_its_body_has_nothing_outside(avatar, filmed, motion):
    looks = filmed_looks(avatar, filmed, motion, TRAIN)
    assert outside_share(looks) == pytest.approx(0, abs=1e-3)
    assert outside_share(turntable(avatar, filmed, motion)) == pytest.approx(0, abs=1e-3)
    assert far_share(avatar) == 0


def test_gaussians_beside_the_body_are_outside_from_every_side(avatar, filmed, motion):
    stray = displaced(avatar, 0.2, 1.0)
    assert 0.1 < far_share(stray) <= 0.2  # some land on the other arm
    assert outside_share(filmed_looks(stray, filmed, motion, TRAIN)) > 0.1
    sides = turntable(stray, filmed, motion)
    assert len(sides) == SIDES
    assert outside_share(sides) > 0.1


def bent(motion, degrees: float):
    """Bent at the hips, towards where the person looks: legs stay as they were."""
    poses, angle = motion.centre, float(np.deg2rad(degrees))
    lean = axis_angle_to_quat(torch.tensor([[angle, 0.0, 0.0]])).expand(len(poses.transl), 4)
    orient = quat_to_axis_angle(quat_multiply(lean, axis_angle_to_quat(poses.global_orient)))
    pose = poses.body_pose.clone()
    for side in ("left", "right"):
        pose[:, SMPL_JOINT_NAMES.index(f"{side}_hip") - 1, 0] -= angle
    changed = dataclasses.replace(poses, global_orient=orient, body_pose=pose)
    return dataclasses.replace(motion, centre=changed)


def axis_of(filmed, motion, *, as_a_file: bool) -> torch.Tensor:
    """What a turntable turns about, in the camera's axes; as a file, these are the world's."""
    viewmat = filmed.camera.viewmat
    if not as_a_file:
        assert not filmed.cameras.world_is_a_cameras
        return avatar_measures._axis(filmed, motion.centre) @ viewmat[:3, :3].T
    cameras = dataclasses.replace(
        filmed.cameras, viewmats=filmed.cameras.viewmats @ torch.linalg.inv(viewmat)
    )
    cameras.viewmats[filmed.train_camera] = torch.eye(4)
    poses = seen_by(viewmat, filmed.body, motion.centre)
    return avatar_measures._axis(dataclasses.replace(filmed, cameras=cameras, poses=poses), poses)


def seen_by(viewmat: torch.Tensor, body: Body, poses: Poses) -> Poses:
    """The poses in a camera's axes."""
    turn = matrix_to_quat(viewmat[:3, :3]).expand(len(poses.transl), 4)
    orient = quat_multiply(turn, axis_angle_to_quat(poses.global_orient))
    pelvis = shaped_joints(body, poses.betas)[0]
    transl = (poses.transl + pelvis) @ viewmat[:3, :3].T + viewmat[:3, 3] - pelvis
    return dataclasses.replace(poses, global_orient=quat_to_axis_angle(orient), transl=transl)


def off_vertical(axis: torch.Tensor, viewmat: torch.Tensor) -> float:
    """Degrees from the direction that is up in the studio."""
    up = viewmat[:3, :3] @ torch.tensor([0.0, 1.0, 0.0])
    return float(torch.rad2deg(torch.arccos((axis @ up).clamp(-1, 1))))


@pytest.mark.parametrize(("degrees", "off"), [(0.0, 0), (10.0, 10), (25.0, 0), (50.0, 0)])
def test_who_bends_before_a_camera_is_turned_about_the_stage_s_up(filmed, motion, degrees, off):
    axis = axis_of(filmed, bent(motion, degrees), as_a_file=True)
    assert axis.norm() == pytest.approx(1)
    # Whose weight is before her feet seems to lean: up is as much as a fifth of her bend off.
    assert off_vertical(axis, filmed.camera.viewmat) == pytest.approx(off, abs=3 + degrees / 5)


@pytest.mark.parametrize("degrees", [0.0, 25.0, 50.0])
def test_in_a_calibrated_world_people_are_turned_about_their_trunk(filmed, motion, degrees):
    axis = axis_of(filmed, bent(motion, degrees), as_a_file=False)
    assert off_vertical(axis, filmed.camera.viewmat) == pytest.approx(degrees, abs=3)


def test_the_turntable_turns_about_that_axis(avatar, filmed, motion, monkeypatch):
    axis = torch.nn.functional.normalize(torch.tensor([0.3, 1.0, 0.2]), dim=0)
    turned = []
    beside = avatar_measures._beside

    def watched(observations, poses, angle):
        turned.append(angle)
        return beside(observations, poses, angle)

    monkeypatch.setattr(avatar_measures, "_beside", watched)
    monkeypatch.setattr(avatar_measures, "_axis", lambda *_: axis)
    assert len(turntable(avatar, filmed, motion)) == SIDES
    for side, angle in enumerate(turned):
        torch.testing.assert_close(angle, 2 * torch.pi * side / SIDES * axis)


def test_what_stands_off_by_less_than_the_margin_is_clothing(avatar, filmed, motion):
    within = displaced(avatar, 1.0, 0.5 * MARGIN)
    assert far_share(within) < 0.05
    assert outside_share(filmed_looks(within, filmed, motion, TRAIN)) < 0.02


def test_an_avatar_that_covers_nothing_has_no_share(avatar, filmed, motion):
    with torch.no_grad():
        avatar.gaussians.opacity_logits.fill_(-30)
    assert outside_share(filmed_looks(avatar, filmed, motion, TRAIN)) is None


def test_a_perfect_avatar_explains_everything_and_the_mean_colour_nothing(avatar, filmed, motion):
    looks = filmed_looks(avatar, filmed, motion, TRAIN)
    assert explained_share(filmed, looks, TRAIN) > 0.99
    assert own_explained_share(filmed, looks, TRAIN) > 0.99
    assert coverage_iou(filmed, looks, TRAIN) > 0.97
    weights = filmed.mattes[TRAIN].float()[..., None] / 255
    mean = (weights * filmed.frames[TRAIN].float() / 255).sum((0, 1, 2)) / weights.sum()
    flat = [dataclasses.replace(look, image=mean.expand_as(look.image).clone()) for look in looks]
    assert explained_share(filmed, flat, TRAIN) == pytest.approx(0, abs=1e-4)
    wrong = [dataclasses.replace(look, image=1 - look.image) for look in looks]
    assert explained_share(filmed, wrong, TRAIN) < 0


def darkened(look, along):
    """A look at somebody dark, so many pixels to the right."""
    image, alpha = (torch.roll(part, along, dims=1) for part in (0.2 * look.image, look.alpha))
    return dataclasses.replace(look, image=image, alpha=alpha)


def test_before_a_bright_wall_an_edge_a_pixel_off_says_little_of_who_is_dark(
    avatar, filmed, motion
):
    looks = [darkened(look, 0) for look in filmed_looks(avatar, filmed, motion, TRAIN)]
    wall = torch.full_like(filmed.frames[:1], 255)
    lit = dataclasses.replace(filmed, backgrounds=wall)
    frames = [as_filmed(lit, p, one.image, one.alpha) for p, one in zip(TRAIN, looks, strict=True)]
    lit.frames[TRAIN] = (255 * torch.stack(frames)).round().to(torch.uint8)
    beside = [darkened(look, 1) for look in filmed_looks(avatar, filmed, motion, TRAIN)]
    assert explained_share(lit, looks, TRAIN) > 0.99
    assert own_explained_share(lit, looks, TRAIN) > 0.99
    assert explained_share(lit, beside, TRAIN) < 0.3
    assert own_explained_share(lit, beside, TRAIN) > 0.8
    nobody = [dataclasses.replace(one, alpha=0 * one.alpha, image=0 * one.image) for one in looks]
    assert own_explained_share(lit, nobody, TRAIN) == pytest.approx(0, abs=0.05)
    assert explained_share(lit, nobody, TRAIN) < -1
    inverted = [dataclasses.replace(one, image=one.alpha[..., None] - one.image) for one in looks]
    assert own_explained_share(lit, inverted, TRAIN) < 0


def test_pixels_that_cannot_be_compared_explain_nothing(avatar, filmed, motion):
    looks = filmed_looks(avatar, filmed, motion, TRAIN)
    none = dataclasses.replace(filmed, comparable=torch.zeros_like(filmed.mattes))
    assert explained_share(none, looks, TRAIN) is None
    assert own_explained_share(none, looks, TRAIN) is None


def test_a_limb_that_the_masks_do_not_confirm_is_found(filmed, motion):
    shares = parts_inside(filmed, motion, TRAIN)
    assert set(shares) == {"left arm", "right arm", "left leg", "right leg", "head"}
    assert min(shares.values()) > 0.9
    raised = motion.centre.body_pose.clone()
    joint = filmed.body.joint_names.index("left_shoulder") - 1
    raised[:, joint, 2] += np.pi / 2
    wrong = dataclasses.replace(motion, centre=dataclasses.replace(motion.centre, body_pose=raised))
    told = parts_inside(filmed, wrong, TRAIN)
    assert told["left arm"] < 0.3
    assert min(share for part, share in told.items() if part != "left arm") > 0.9
