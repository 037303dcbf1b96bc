import json
import subprocess
import sys
from pathlib import Path

from deblur_avatar.artifacts import Observations

ROOT = Path(__file__).resolve().parents[2]
PARAMS = """
seed: 0
predeblur:
  tiny: {given: "", lengths: [3.0], angles: 2, balance: 0.5, surroundings: 3.0, gain: 0.05}
"""


def test_the_script_writes_observations_and_says_how_far_they_are_from_the_sharp_ones(
    observations: Observations, tmp_path: Path
):
    observations.save(tmp_path / "blurred")
    (tmp_path / "params.yaml").write_text(PARAMS)
    options = {
        "scene": "tiny",
        "observations": tmp_path / "blurred",
        "sharp": tmp_path / "blurred",
        "out": tmp_path / "deblurred",
        "metrics": tmp_path / "metrics.json",
        "params-file": tmp_path / "params.yaml",
    }
    words = [word for name, value in options.items() for word in (f"--{name}", str(value))]
    done = subprocess.run(
        [sys.executable, "stages/predeblur.py", *words],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert Observations.load(tmp_path / "deblurred").frames.shape == observations.frames.shape
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["method"] == "matte"
    assert {f"psnr_{which}" for which in ("blurred", "deblurred")} < set(metrics)
