"""Tests of surface quality: each statistic knows what it is named after."""

import dataclasses

import numpy as np
import pytest
import torch

from deblur_avatar.evaluation.avatar_measures import Look
from deblur_avatar.evaluation.surface_quality import CLOTHES, clothes_share, surface_quality


def test_an_avatar_on_its_body_has_no_fur_few_holes_and_no_needles(avatar, filmed, motion):
    found = surface_quality(avatar, filmed, motion)
    assert found["fur_share"] < 0.06  # of Gaussians as wide as an arm
    assert found["holes_share"] < 0.01
    assert found["needle_share"] == 0
    assert sum(found["opacity_histogram"]) == pytest.approx(1)


def test_gaussians_that_stand_off_the_clothes_are_fur(avatar, filmed, motion):
    before = surface_quality(avatar, filmed, motion)["fur_share"]
    with torch.no_grad():
        avatar.gaussians.means[::4, 0] += 3 * CLOTHES
    assert surface_quality(avatar, filmed, motion)["fur_share"] > before + 0.05


def test_a_half_that_is_missing_is_holes(avatar, filmed, motion):
    with torch.no_grad():
        avatar.gaussians.opacity_logits[avatar.gaussians.means[:, 0] > 0] = -20
    found = surface_quality(avatar, filmed, motion)
    assert 0.15 < found["holes_share"] < 0.6  # wide neighbours cover some of it
    assert found["opacity_histogram"][0] > 0.4


def test_long_gaussians_are_needles_weighted_by_their_opacity(avatar, filmed, motion):
    with torch.no_grad():
        avatar.gaussians.log_scales[:, 1:] = -6
        avatar.gaussians.log_scales[:, 0] = -6 + torch.tensor(10.0).log()
        avatar.gaussians.log_scales[::2, 0] = -6
        avatar.gaussians.opacity_logits[::2] = 0.0
        avatar.gaussians.opacity_logits[1::2] = torch.tensor(0.25).logit()
    assert surface_quality(avatar, filmed, motion)["needle_share"] == pytest.approx(1 / 3, abs=0.01)


def test_an_avatar_that_covers_nothing_has_no_share(avatar, filmed, motion):
    with torch.no_grad():
        avatar.gaussians.opacity_logits.fill_(-30)
    found = surface_quality(avatar, filmed, motion)
    assert found["fur_share"] is None
    assert found["holes_share"] == pytest.approx(1)


def test_clothes_are_what_masks_show_beyond_the_reach_of_most(filmed):
    height, width = filmed.mattes.shape[1:]
    mattes = torch.zeros_like(filmed.mattes)
    mattes[0, :, :4], mattes[2, :, :4] = 255, 51
    distance = np.zeros((height, width))
    distance[:, :1] = 1.01 * CLOTHES
    distance[:, 1] = CLOTHES
    looks = [Look(torch.zeros(height, width, 3), torch.zeros(height, width), distance)] * 2
    dressed = dataclasses.replace(filmed, mattes=mattes)
    assert clothes_share(dressed, looks, [0, 2]) == pytest.approx(0.25)
    looks = [looks[0], dataclasses.replace(looks[0], distance=np.zeros((height, width)))]
    assert clothes_share(dressed, looks, [0, 2]) == pytest.approx(0.25 / 1.2)
    assert clothes_share(dressed, looks, [1, 3]) == 0
    lost = dataclasses.replace(looks[0], distance=np.full((height, width), np.inf))
    assert clothes_share(dressed, [lost, looks[0]], [0, 2]) == pytest.approx(0.25)
