import json
from pathlib import Path

import pytest

from deblur_avatar.config.runs import RunParams
from deblur_avatar.errors import ArtifactError
from deblur_avatar.evaluation.costs import read_costs

RUN = RunParams(scene="hall", observations="sharp", start="plain", method="oracle")


def measured(folder: Path, stage: str, item: str, seconds: float, megabytes: float) -> Path:
    path = folder / stage / f"{item}.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps({"seconds": seconds, "peak_memory_mb": megabytes, "gaussians": 3}))
    return path


def test_seconds_add_up_and_the_largest_stage_sets_the_memory(tmp_path):
    measured(tmp_path, "warmup", "hall-sharp-plain", 10.0, 500.0)
    measured(tmp_path, "trajectory", "hall-oracle", 20.0, 900.0)
    measured(tmp_path, "fusion", "hall-oracle", 5.5, 700.0)
    assert read_costs(tmp_path, RUN) == {
        "train_s": 35.5,
        "warmup_s": 10.0,
        "trajectory_s": 20.0,
        "fusion_s": 5.5,
        "peak_memory_mb": 900.0,
    }


def test_a_stage_without_measurement_leaves_the_sum_unknown(tmp_path):
    measured(tmp_path, "fusion", "hall-oracle", 5.5, 700.0)
    costs = read_costs(tmp_path, RUN)
    assert costs["train_s"] is None
    assert costs["warmup_s"] is None
    assert costs["fusion_s"] == 5.5
    assert costs["peak_memory_mb"] == 700.0
    assert read_costs(tmp_path / "nowhere", RUN)["peak_memory_mb"] is None


@pytest.mark.parametrize("text", ["{", "[]", '{"seconds": 1}'])
def test_a_damaged_measurement_is_named(tmp_path, text):
    path = measured(tmp_path, "fusion", "hall-oracle", 1.0, 1.0)
    path.write_text(text)
    with pytest.raises(ArtifactError, match=r"fusion/hall-oracle.json"):
        read_costs(tmp_path, RUN)
