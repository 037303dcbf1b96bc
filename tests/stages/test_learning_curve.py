import json
from pathlib import Path

from tests.filmed_scene import film
from tests.stages.running import run_script


def test_the_stage_scores_a_few_pixels(painted, make_observations, tmp_path: Path):
    scene = film(painted(frames=8), make_observations(frames=8))
    scene.observations.save(tmp_path / "observations")
    scene.reference.save(tmp_path / "reference")
    (tmp_path / "params.yaml").write_text("seed: 3\n")
    options = {"scene": "hall", "method": "oracle", "metrics": tmp_path / "metrics.json"}
    options |= {name: tmp_path / name for name in ("observations", "reference")}
    for stage in ("warmup", "trajectory", "fusion"):
        options[stage] = tmp_path / stage
        for folder in (options[stage], options[stage] / "snapshots" / "000002"):
            scene.avatar.save(folder / "avatar")
            scene.motion.save(folder / "motion")
    options["params_file"] = tmp_path / "params.yaml"
    done = run_script("learning_curve", **options)
    assert done.returncode == 0, done.stderr
    content = json.loads((tmp_path / "metrics.json").read_text())
    assert (content["scene"], content["method"]) == ("hall", "oracle")
    assert [(point["stage"], point["iteration"]) for point in content["points"]] == [
        ("warmup", 2), ("trajectory", 2), ("fusion", 2),
    ]  # fmt: skip
