import dataclasses
import json

import pytest
import torch

from deblur_avatar.config.runs import RunParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.comparisons import compare
from deblur_avatar.evaluation.truth_views import truth_views
from deblur_avatar.pipeline.timeline import (
    VIEWS,
    moments_of,
    timeline,
)
from deblur_avatar.training.resume import Snapshot

CPU = torch.device("cpu")
RUN = RunParams(scene="hall", observations="sharp", start="plain", method="oracle")
ITEMS = {"warmup": "hall-sharp-plain", "trajectory": "hall-oracle", "fusion": "hall-oracle"}
SNAPSHOTS = {"warmup": [(2, 1.0), (4, 3.5)], "trajectory": [(6, 5.0)], "fusion": [(7, 0.5)]}
SECONDS = {"warmup": 4.0, "trajectory": 6.0, "fusion": 2.0}


def write_costs(folder, snapshots):
    for stage, item in ITEMS.items():
        path = folder / stage / f"{item}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        kept = [{"iteration": i, "seconds": s} for i, s in snapshots[stage]]
        path.write_text(json.dumps({"seconds": SECONDS[stage], "snapshots": kept}))


@pytest.fixture
def trained(scene, tmp_path):
    """A run that was right from the start of its second stage on."""
    stages = {stage: tmp_path / "data" / stage for stage in ITEMS}
    gray = dataclasses.replace(scene.avatar, features=torch.zeros_like(scene.avatar.features))
    for stage, kept in SNAPSHOTS.items():
        avatar = gray if stage == "warmup" else scene.avatar
        for iteration, _ in kept:
            folder = stages[stage] / "snapshots" / f"{iteration:06d}"
            Snapshot(avatar=avatar, motion=scene.motion).save(folder)
        avatar.save(stages[stage] / "avatar")
    for stage in ("trajectory", "fusion"):
        scene.motion.save(stages[stage] / "motion")
    write_costs(tmp_path / "costs", SNAPSHOTS)
    return stages, tmp_path / "costs"


def test_seconds_go_on_from_stage_to_stage(trained):
    moments = moments_of(*trained, RUN)
    assert [(m.stage, m.iteration, m.seconds) for m in moments] == [
        ("warmup", 2, 1.0), ("warmup", 4, 3.5), ("trajectory", 6, 9.0), ("fusion", 7, 10.5),
    ]  # fmt: skip


def test_without_snapshots_the_ends_of_stages_with_a_motion_are_left(trained):
    stages, costs = trained
    write_costs(costs, dict.fromkeys(ITEMS, ()))
    moments = moments_of(stages, costs, RUN)
    assert [(m.stage, m.iteration, m.seconds) for m in moments] == [
        ("trajectory", 7, 10.0), ("fusion", 7, 12.0),
    ]  # fmt: skip


def test_every_snapshot_is_scored_on_the_same_views(scene, trained):
    content = timeline(scene.observations, scene.reference, *trained, RUN, CPU)
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
    content = timeline(scene.observations, scene.reference, *trained, RUN, CPU)
    views = truth_views(scene.observations, scene.reference)
    model = painted(frames=8)
    scores = [
        compare(model, scene.observations, scene.reference, view, scene.motion.centre).scores
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
    content = timeline(scene.observations, reference, *trained, RUN, CPU)
    assert content["views"] == 0
    assert {point["image"] for point in content["points"]} == {None}
    assert content["points"][-1]["validation_psnr"] > 30


def test_measurements_of_before_there_were_snapshots_are_named(trained):
    stages, costs = trained
    path = costs / "trajectory" / "hall-oracle.json"
    path.write_text(json.dumps({"seconds": 1.0}))
    with pytest.raises(ArtifactError, match=r"trajectory/hall-oracle.json is damaged"):
        moments_of(stages, costs, RUN)


@pytest.mark.parametrize("seconds", ["1.0", "nan", [1.0], None, 10**400])
@pytest.mark.parametrize("where", ["stage", "snapshot"])
def test_times_that_are_no_numbers_are_named(trained, seconds, where):
    stages, costs = trained
    kept = [{"iteration": 2, "seconds": seconds if where == "snapshot" else 1.0}]
    path = costs / "trajectory" / "hall-oracle.json"
    cost = {"seconds": seconds if where == "stage" else 1.0, "snapshots": kept}
    path.write_text(json.dumps(cost))
    with pytest.raises(ArtifactError, match=r"trajectory/hall-oracle\.json"):
        moments_of(stages, costs, RUN)
