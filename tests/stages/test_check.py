import json
import subprocess
from pathlib import Path

from tests.stages.running import run_script


def run_stage(folder: Path, fit: Path) -> "subprocess.CompletedProcess[str]":
    (folder / "params.yaml").write_text("check: {on_failure: stop}\n")
    options = {
        "scene": "hall", "observations": folder / "observations", "fit": fit, "out": folder / "out",
        "metrics": folder / "metrics.json", "params_file": folder / "params.yaml",
    }  # fmt: skip
    return run_script("check", **options)


def test_the_stage_checks_a_few_pixels_and_stops_at_what_fails(make_observations, tmp_path):
    make_observations().save(tmp_path / "observations")
    (tmp_path / "fit.json").write_text(json.dumps({"fit": {}}))
    done = run_stage(tmp_path, tmp_path / "fit.json")
    assert done.returncode == 1  # four training frames of a person 20 pixels tall
    assert "ArtifactError: scene hall fails its check" in done.stderr
    assert "Traceback" not in done.stderr
    findings = json.loads((tmp_path / "metrics.json").read_text())["findings"]
    assert findings["training_frames"] == {
        "value": 4, "unit": "frames", "verdict": "fail",
        "advice": "Film longer, or lower clip.stride.",
    }  # fmt: skip
    assert (tmp_path / "out" / "check.png").is_file()
    assert "hall" in (tmp_path / "out" / "index.html").read_text()


def test_metrics_that_are_not_there_are_one_clear_error(make_observations, tmp_path):
    make_observations().save(tmp_path / "observations")
    done = run_stage(tmp_path, tmp_path / "nowhere.json")
    assert done.returncode == 1
    assert "nowhere.json" in done.stderr
    assert "Traceback" not in done.stderr
