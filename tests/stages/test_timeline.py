import json
from pathlib import Path

from tests.filmed_scene import film
from tests.stages.running import run_script

PARAMS = """
seed: 3
runs:
  hall-oracle: {scene: hall, observations: sharp, start: plain, method: oracle}
"""


def test_the_stage_scores_a_few_pixels(painted, make_observations, tmp_path: Path):
    scene = film(painted(frames=8), make_observations(frames=8))
    scene.observations.save(tmp_path / "observations")
    scene.reference.save(tmp_path / "reference")
    (tmp_path / "params.yaml").write_text(PARAMS)
    options = {"scene": "hall", "method": "oracle", "metrics": tmp_path / "metrics.json"}
    options |= {name: tmp_path / name for name in ("observations", "reference", "costs")}
    for stage, item in (
        ("warmup", "hall-sharp-plain"), ("trajectory", "hall-oracle"), ("fusion", "hall-oracle"),
    ):  # fmt: skip
        options[stage] = tmp_path / stage
        for folder in (options[stage], options[stage] / "snapshots" / "000002"):
            scene.avatar.save(folder / "avatar")
            scene.motion.save(folder / "motion")
        costs = options["costs"] / stage / f"{item}.json"
        costs.parent.mkdir(parents=True)
        kept = [{"iteration": 2, "seconds": 1.5}]
        costs.write_text(json.dumps({"seconds": 2.0, "snapshots": kept}))
    options["params_file"] = tmp_path / "params.yaml"
    done = run_script("timeline", **options)
    assert done.returncode == 0, done.stderr
    content = json.loads((tmp_path / "metrics.json").read_text())
    assert (content["scene"], content["method"]) == ("hall", "oracle")
    assert [point["seconds"] for point in content["points"]] == [1.5, 3.5, 5.5]
