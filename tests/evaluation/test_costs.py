import json
from pathlib import Path

import pytest

from deblur_avatar.config.runs import RunParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.costs import cost_files, read_costs, with_seconds

RUN = RunParams(scene="hall", observations="sharp", avatar="plain", method="oracle")


def measured(folder: Path, stage: str, item: str, seconds: float, megabytes: float) -> Path:
    path = folder / stage / f"{item}.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({"seconds": seconds, "peak_memory_mb": megabytes, "gaussians": 3}))
    return path


def test_seconds_add_up_and_the_largest_stage_sets_the_memory(tmp_path):
    measured(tmp_path, "warmup", "hall-sharp-plain", 10.0, 500.0)
    measured(tmp_path, "trajectory", "hall-oracle", 20.0, 900.0)
    measured(tmp_path, "fusion", "hall-oracle", 5.5, 700.0)
    assert read_costs(cost_files(tmp_path, RUN)) == {
        "train_s": 35.5,
        "warmup_s": 10.0,
        "trajectory_s": 20.0,
        "fusion_s": 5.5,
        "peak_memory_mb": 900.0,
        "render_fps": None,
    }
    path = tmp_path / "evaluate/hall-oracle.json"
    path.parent.mkdir()
    path.write_text('{"render_fps": 31.5}')
    assert read_costs(cost_files(tmp_path, RUN))["render_fps"] == 31.5


def test_a_stage_without_measurement_leaves_the_sum_unknown(tmp_path):
    measured(tmp_path, "fusion", "hall-oracle", 5.5, 700.0)
    costs = read_costs(cost_files(tmp_path, RUN))
    assert costs["train_s"] is None
    assert costs["warmup_s"] is None
    assert costs["fusion_s"] == 5.5
    assert costs["peak_memory_mb"] == 700.0
    assert read_costs(cost_files(tmp_path / "nowhere", RUN))["peak_memory_mb"] is None


@pytest.mark.parametrize("text", ["{", "[]", '{"seconds": 1}'])
def test_a_damaged_measurement_is_named(tmp_path, text):
    path = measured(tmp_path, "fusion", "hall-oracle", 1.0, 1.0)
    path.write_text(text)
    with pytest.raises(ArtifactError, match=r"fusion/hall-oracle.json"):
        read_costs(cost_files(tmp_path, RUN))


ITEMS = {"warmup": "hall-sharp-plain", "trajectory": "hall-oracle", "fusion": "hall-oracle"}
SNAPSHOTS = {"warmup": [(2, 1.0), (4, 3.5)], "trajectory": [(6, 5.0)], "fusion": [(7, 0.5)]}
SECONDS = {"warmup": 4.0, "trajectory": 6.0, "fusion": 2.0}


def kept(folder, snapshots):
    """Write what three stages measured, and a learning curve of what they kept."""
    for stage, item in ITEMS.items():
        path = folder / stage / f"{item}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        taken = [{"iteration": i, "seconds": s} for i, s in snapshots[stage]]
        path.write_text(json.dumps({"seconds": SECONDS[stage], "snapshots": taken}))
    points = [{"stage": s, "iteration": i} for s in ITEMS for i, _ in snapshots[s]]
    return {"disk_mb": 1.0, "points": points}


def test_seconds_go_on_from_stage_to_stage(tmp_path):
    told = with_seconds(kept(tmp_path, SNAPSHOTS), cost_files(tmp_path, RUN))
    assert [point["seconds"] for point in told["points"]] == [1.0, 3.5, 9.0, 10.5]
    assert told["disk_mb"] == 1.0


def test_without_snapshots_there_are_the_ends_of_stages(tmp_path):
    kept(tmp_path, dict.fromkeys(ITEMS, ()))
    ends = [{"stage": "trajectory", "iteration": 7}, {"stage": "fusion", "iteration": 8}]
    told = with_seconds({"points": ends}, cost_files(tmp_path, RUN))
    assert [point["seconds"] for point in told["points"]] == [10.0, 12.0]


def test_times_of_another_run_than_the_timeline_are_refused(tmp_path):
    curve = kept(tmp_path, SNAPSHOTS)
    curve["points"][2]["iteration"] = 5
    message = r"trajectory/hall-oracle\.json knows no snapshot of iteration 5; .* `dvc repro`"
    with pytest.raises(ArtifactError, match=message):
        with_seconds(curve, cost_files(tmp_path, RUN))


@pytest.mark.parametrize("seconds", ["1.0", "nan", [1.0], None, 10**400])
@pytest.mark.parametrize("where", ["stage", "snapshot"])
def test_times_that_are_no_numbers_are_named(tmp_path, seconds, where):
    curve = kept(tmp_path, SNAPSHOTS)
    taken = [{"iteration": 6, "seconds": seconds if where == "snapshot" else 1.0}]
    cost = {"seconds": seconds if where == "stage" else 1.0, "snapshots": taken}
    (tmp_path / "trajectory/hall-oracle.json").write_text(json.dumps(cost))
    with pytest.raises(ArtifactError, match=r"trajectory/hall-oracle\.json"):
        with_seconds(curve, cost_files(tmp_path, RUN))
