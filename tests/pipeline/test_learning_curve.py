import dataclasses
import shutil

import pytest
import torch

from deblur_avatar.evaluation.comparisons import compare
from deblur_avatar.evaluation.truth_views import truth_views
from deblur_avatar.pipeline.learning_curve import (
    VIEWS,
    learning_curve,
    moments_of,
)
from deblur_avatar.training.resume import Snapshot

CPU = torch.device("cpu")
SNAPSHOTS = {"warmup": (2, 4), "trajectory": (6,), "fusion": (7,)}


@pytest.fixture
def trained(scene, tmp_path):
    """A run that was right from the start of its second stage on."""
    stages = {stage: tmp_path / "data" / stage for stage in SNAPSHOTS}
    gray = dataclasses.replace(scene.avatar, features=torch.zeros_like(scene.avatar.features))
    for stage, kept in SNAPSHOTS.items():
        avatar = gray if stage == "warmup" else scene.avatar
        for iteration in kept:
            folder = stages[stage] / "snapshots" / f"{iteration:06d}"
            Snapshot(avatar=avatar, motion=scene.motion).save(folder)
        avatar.save(stages[stage] / "avatar")
    for stage in ("trajectory", "fusion"):
        scene.motion.save(stages[stage] / "motion")
    return stages


def test_snapshots_come_in_the_order_of_stages_and_iterations(trained):
    moments = moments_of(trained)
    assert [(m.stage, m.iteration) for m in moments] == [
        ("warmup", 2), ("warmup", 4), ("trajectory", 6), ("fusion", 7),
    ]  # fmt: skip


def test_without_snapshots_the_ends_of_stages_with_a_motion_are_left(trained):
    for folder in trained.values():
        shutil.rmtree(folder / "snapshots")
    moments = moments_of(trained)
    assert [(m.stage, m.iteration) for m in moments] == [("trajectory", 7), ("fusion", 7)]


def test_every_snapshot_is_scored_on_the_same_views(scene, trained):
    content = learning_curve(scene.observations, scene.reference, trained, CPU)
    views = truth_views(scene.observations, scene.reference)
    novel = [view for view in views if not view.novel_pose]
    assert content["views"] == len(novel) <= VIEWS
    assert content["validation"] == 1
    first, _, third, last = content["points"]
    assert first["image"]["psnr"] < third["image"]["psnr"] - 3
    assert first["validation_psnr"] < third["validation_psnr"] - 3
    assert last["image"] == third["image"]
    assert first["gaussians"] == len(scene.avatar.means)
    model = scene.avatar
    assert content["disk_mb"] > 4e-6 * model.means.numel()


def test_scores_are_those_of_the_evaluation(scene, trained, painted):
    content = learning_curve(scene.observations, scene.reference, trained, CPU)
    views = truth_views(scene.observations, scene.reference)
    model = painted(frames=8)
    scores = [
        compare(
            model,
            scene.observations,
            scene.reference,
            view,
            scene.motion.centre.at([view.position]),
        ).scores
        for view in views
        if not view.novel_pose
    ]
    mean = sum(score["psnr"] for score in scores) / len(scores)
    assert content["points"][-1]["image"]["psnr"] == pytest.approx(mean, abs=0.01)


def test_footage_without_truth_is_scored_on_frames_set_aside(scene, trained):
    reference = dataclasses.replace(
        scene.reference,
        **{
            name: getattr(scene.reference, name)[:0]
            for name in ("images", "mattes", "camera_indices", "frame_indices", "novel_pose")
        },
    )
    content = learning_curve(scene.observations, reference, trained, CPU)
    assert content["views"] == 0
    assert {point["image"] for point in content["points"]} == {None}
    assert content["points"][-1]["validation_psnr"] > 30
