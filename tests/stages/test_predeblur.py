import json
from pathlib import Path

from deblur_avatar.artifacts.observations import Observations
from tests.stages.running import run_script

PARAMS = """
seed: 0
predeblur:
  tiny:
    given: ""
    deblurrer:
      {kind: matte, lengths: [3.0], angles: 2, regularisation: 0.5, window_sigma: 3.0, gain: 0.05}
"""


def test_the_scripts_write_observations_and_how_far_they_are_from_the_sharp_ones(
    observations: Observations, tmp_path: Path
):
    observations.save(tmp_path / "blurred")
    (tmp_path / "params.yaml").write_text(PARAMS)
    options = {
        "scene": "tiny",
        "observations": tmp_path / "blurred",
        "out": tmp_path / "deblurred",
        "metrics": tmp_path / "metrics.json",
        "params_file": tmp_path / "params.yaml",
    }
    done = run_script("predeblur", **options)
    assert done.returncode == 0, done.stderr
    assert Observations.load(tmp_path / "deblurred").frames.shape == observations.frames.shape
    assert json.loads((tmp_path / "metrics.json").read_text())["method"] == "matte"
    options = {name: options[name] for name in ("scene", "observations", "metrics")}
    options |= {"deblurred": tmp_path / "deblurred", "sharp": tmp_path / "blurred"}
    done = run_script("score_predeblur", **options)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert {f"psnr_{which}" for which in ("blurred", "deblurred")} < set(metrics)
