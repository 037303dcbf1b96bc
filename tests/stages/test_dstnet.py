import json
from pathlib import Path

from ruamel.yaml import YAML

from deblur_avatar.artifacts.body import Body
from deblur_avatar.imaging.dstnet_weights import DstnetWeights
from tests.sources.studio.test_deblurring_takes import PARAMS as TAKES
from tests.stages.running import run_script


def test_from_a_body_to_weights_and_their_scores(body: Body, tmp_path: Path):
    body.save(tmp_path / "body")
    network = {"features": 2, "blocks": 1, "refinements": 1}
    takes = TAKES.model_copy(update={"windows": (9,), "frames": 2})
    training = {
        "network": network, "iterations": 3, "batch": 1, "frames": 2, "size": 16, "rate": 1e-3,
        "final_rate": 1e-6, "rise": 1, "weight_decay": 1e-4, "frequencies": 0.1,
    }  # fmt: skip
    weights = tmp_path / "weights"
    deblurrer = {"kind": "dstnet_small", "weights": str(weights), "frames_at_once": 30}
    content = {
        "seed": 0,
        "deblurring_clips": {"training": 1, "validation": 1, "takes": takes.model_dump()},
        "dstnet": training,
        "score_dstnet": {"deblurrers": {"ours": deblurrer}, "shown_window": 9},
    }
    with (tmp_path / "params.yaml").open("w") as file:
        YAML().dump(json.loads(json.dumps(content)), file)
    params = {"params_file": tmp_path / "params.yaml"}
    clips = tmp_path / "clips"
    done = run_script("deblurring_clips", body=tmp_path / "body", out=clips, **params)
    assert done.returncode == 0, done.stderr
    work = tmp_path / "work"
    done = run_script("dstnet", clips=clips / "training", work=work, out=weights, **params)
    assert done.returncode == 0, done.stderr
    assert json.loads(DstnetWeights.load(weights).recipe)["iterations"] == 3
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".work")]
    scores, strip = tmp_path / "scores.json", tmp_path / "strip.png"
    done = run_script(
        "score_dstnet", clips=clips / "validation", metrics=scores, strip=strip, **params
    )
    assert done.returncode == 0, done.stderr
    assert set(json.loads(scores.read_text())["9"]) == {"blurred", "ours"}
    assert strip.stat().st_size > 0
