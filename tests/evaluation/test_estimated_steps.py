import dataclasses

import pytest
import torch

from deblur_avatar.artifacts.reference import FilmedTruth
from deblur_avatar.evaluation.comparisons import true_poses
from deblur_avatar.evaluation.estimated_steps import (
    estimated_steps,
    joint_errors,
    matte_errors,
)

FRAMES, SIZE, CLIP_SIZE = 8, 24, 48


def filmed(scene) -> FilmedTruth:
    """The observations' mattes at the clip's size, for every frame of the clip."""
    last = scene.observations.frame_indices[-1]
    mattes = torch.zeros(last + 1, CLIP_SIZE, CLIP_SIZE, dtype=torch.uint8)
    large = scene.observations.mattes.repeat_interleave(2, 1).repeat_interleave(2, 2)
    mattes[list(scene.observations.frame_indices)] = large
    return FilmedTruth(mattes=mattes, focal=1.6 * CLIP_SIZE)


def test_footage_without_that_truth_has_no_steps(scene):
    true = true_poses(scene.observations, scene.reference)
    assert estimated_steps(scene.observations, scene.reference, scene.motion, true) is None


def test_what_is_right_has_no_error(scene):
    reference = dataclasses.replace(scene.reference, filmed=filmed(scene))
    true = true_poses(scene.observations, reference)
    steps = estimated_steps(scene.observations, reference, scene.motion, true)
    assert steps["mattes"]["iou"] == pytest.approx(1)
    assert steps["mattes"]["mae"] == pytest.approx(0, abs=1e-6)
    assert steps["focal"]["estimated_px"] == pytest.approx(steps["focal"]["true_px"])
    for poses in steps["poses"].values():
        assert poses["joint_error_mm"] == pytest.approx(0, abs=0.5)
        assert poses["scale"] == pytest.approx(1, abs=1e-3)


def test_mattes_are_compared_by_overlap_and_by_difference(scene):
    truth = filmed(scene)
    mattes = torch.zeros_like(scene.observations.mattes)
    mattes[:, :, :12] = 255  # the left half of every frame
    truth = dataclasses.replace(truth, mattes=torch.zeros_like(truth.mattes))
    truth.mattes[:, :24] = 255  # the upper half
    observations = dataclasses.replace(scene.observations, mattes=mattes)
    errors = matte_errors(observations, truth)
    assert errors["iou"] == pytest.approx(1 / 3)
    assert errors["mae"] == pytest.approx(1 / 2)


def test_errors_of_joints_are_told_apart():
    generator = torch.Generator().manual_seed(0)
    true = torch.randn(5, 24, 3, generator=generator) + torch.tensor([0.0, 0, 4])
    errors = joint_errors(1.25 * true, true)
    assert errors["depth_ratio"] == pytest.approx(1.25)
    assert errors["scale"] == pytest.approx(0.8)
    assert errors["registered_mm"] == pytest.approx(0, abs=1e-3)
    assert errors["rooted_mm"] > 100
    shifted = joint_errors(true + torch.tensor([0.03, 0, 0]), true)
    assert shifted["joint_error_mm"] == pytest.approx(30, abs=0.01)
    assert shifted["rooted_mm"] == pytest.approx(0, abs=1e-3)
