"""What a fit goes on from must have come from a fit of the same kind."""

import pytest
import torch
import yaml

from deblur_avatar.training.fitting_stage import fitting_stage


@pytest.fixture
def params(tmp_path, schedule):
    content = {
        "seed": 1,
        "schedule": "tiny",
        "snapshots": 2,
        "schedules": {"tiny": schedule.model_dump(mode="json")},
    }

    def written(**changed):
        path = tmp_path / "params.yaml"
        path.write_text(yaml.safe_dump(content | changed))
        return path

    return written


def begun(tmp_path, path):
    """After how many iterations a fit goes on; it saves after one more and is stopped."""
    out = tmp_path / "item"
    with fitting_stage("warmup", out, path, [], []) as stage:
        known = stage.folder.progress
        done = 0 if known is None else known.iteration
        stage.folder.save(done + 1, 0.5, 0, {"value": torch.ones(1)})
    return done


def test_it_goes_on_after_the_last_save_of_the_same_fit(tmp_path, params):
    assert [begun(tmp_path, params()) for _ in range(3)] == [0, 1, 2]


@pytest.mark.parametrize("change", ["seed", "snapshots", "rasterizer", "device"])
def test_it_begins_anew_where_something_else_decides(tmp_path, params, change, monkeypatch):
    begun(tmp_path, params())
    if change == "rasterizer":
        monkeypatch.setenv("DEBLUR_AVATAR_RASTERIZER", "torch")
    elif change == "device":
        monkeypatch.setenv("DEBLUR_AVATAR_DEVICE", "cpu:0")
    path = params(**({change: 3} if change in ("seed", "snapshots") else {}))
    assert begun(tmp_path, path) == 0
