import dataclasses

import numpy as np
import pytest
import torch

from deblur_avatar.evaluation.avatar_measures import (
    MARGIN,
    SIDES,
    coverage_iou,
    explained_share,
    far_share,
    filmed_looks,
    outside_share,
    parts_inside,
    turntable,
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
    assert coverage_iou(filmed, looks, TRAIN) > 0.97
    weights = filmed.mattes[TRAIN].float()[..., None] / 255
    mean = (weights * filmed.frames[TRAIN].float() / 255).sum((0, 1, 2)) / weights.sum()
    flat = [dataclasses.replace(look, image=mean.expand_as(look.image).clone()) for look in looks]
    assert explained_share(filmed, flat, TRAIN) == pytest.approx(0, abs=1e-4)
    wrong = [dataclasses.replace(look, image=1 - look.image) for look in looks]
    assert explained_share(filmed, wrong, TRAIN) < 0


def test_pixels_that_cannot_be_compared_explain_nothing(avatar, filmed, motion):
    looks = filmed_looks(avatar, filmed, motion, TRAIN)
    none = dataclasses.replace(filmed, comparable=torch.zeros_like(filmed.mattes))
    assert explained_share(none, looks, TRAIN) is None


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
