import subprocess
from pathlib import Path

import numpy as np
from numpy.random import default_rng

from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.capsule import capsule_body
from tests.stages.running import run_script

PARAMS = """
seed: 0
bodies:
  own: {source: smpl, file: "${MODEL_FILE}", shape_components: 2}
"""


def run_stage(tmp_path: Path, model: Path) -> subprocess.CompletedProcess[str]:
    params = tmp_path / "params.yaml"
    params.write_text(PARAMS.replace("${MODEL_FILE}", str(model)))
    return run_script("body", name="own", out=tmp_path / "body", params_file=params)


def write_smpl_like(path: Path) -> None:
    """The capsule body in the format of an SMPL file."""
    body = capsule_body()
    count = len(body.vertices)
    regressor = default_rng(0).uniform(size=(24, count))
    np.savez(
        path,
        v_template=body.vertices.numpy(),
        shapedirs=body.shape_dirs.numpy(),
        posedirs=np.zeros((count, 3, 207), np.float32),
        weights=body.lbs_weights.numpy(),
        J_regressor=regressor / regressor.sum(1, keepdims=True),
        kintree_table=np.array([(-1, *body.parents[1:]), range(24)]),
        f=body.faces.numpy(),
    )


def test_the_stage_writes_a_body(tmp_path: Path):
    write_smpl_like(tmp_path / "model.npz")
    result = run_stage(tmp_path, tmp_path / "model.npz")
    assert result.returncode == 0, result.stderr
    body = Body.load(tmp_path / "body")
    np.testing.assert_allclose(body.vertices, capsule_body().vertices, atol=1e-6)
    assert body.shape_dirs.shape[2] == 2


def test_a_missing_model_is_one_clear_line(tmp_path: Path):
    result = run_stage(tmp_path, tmp_path / "nothing.npz")
    assert result.returncode == 1
    assert "ConfigError: no SMPL model" in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "body").exists()
