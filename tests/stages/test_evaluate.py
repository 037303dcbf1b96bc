import json
import subprocess
from pathlib import Path

import torch

from tests.filmed_scene import film
from tests.stages.running import run_script

PARAMS = """
seed: 3
schedule: medium
"""


def run_stage(folder: Path, method: str) -> "subprocess.CompletedProcess[str]":
    (folder / "params.yaml").write_text(PARAMS)
    options = {
        "scene": "hall",
        "method": method,
        "observations": folder / "observations",
        "reference": folder / "reference",
        "fusion": folder / "fusion",
        "out": folder / "out",
        "metrics": folder / "metrics.json",
        "cost": folder / "cost.json",
        "params_file": folder / "params.yaml",
    }
    return run_script("evaluate", **options)


def test_the_stage_measures_a_few_pixels(painted, make_observations, tmp_path):
    scene = film(painted(frames=8), make_observations(frames=8))
    scene.observations.save(tmp_path / "observations")
    scene.reference.save(tmp_path / "reference")
    scene.avatar.save(tmp_path / "fusion" / "avatar")
    scene.motion.save(tmp_path / "fusion" / "motion")
    done = run_stage(tmp_path, "oracle")
    assert done.returncode == 0, done.stderr
    measured = json.loads((tmp_path / "metrics.json").read_text())
    assert measured["scene"] == "hall"
    assert measured["method"] == "oracle"
    assert measured["image"]["psnr"] > 28
    assert "cost" not in measured
    assert json.loads((tmp_path / "cost.json").read_text())["render_fps"] > 1
    assert measured["run"] == {
        "seed": 3, "device": "cpu", "schedule": "medium", "iterations": 7,
        "precision": "float32", "cpu": torch.backends.cpu.get_cpu_capability(),
    }  # fmt: skip
    views = json.loads((tmp_path / "out" / "views.json").read_text())
    assert all((tmp_path / "out" / view["render"]).exists() for view in views)
