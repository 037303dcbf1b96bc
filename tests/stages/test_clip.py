import subprocess
from pathlib import Path

import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from tests.stages.running import Start, run_script

PARAMS = """
seed: 0
scenes:
  tiny:
    clip:
      source: studio
      motion: turn
      frames: 6
      fps: 60.0
      image_size: 16
      test_cameras: 2
      test_stride: 2
      window: 5
      samples_per_axis: 1
      noise_degrees: 1.5
      noise_mm: 5.0
      noise_correlation_s: 0.1
      held_out: 0.2
"""


def run_stage(
    tmp_path: Path, params: str, run: Start = run_script
) -> subprocess.CompletedProcess[str]:
    (tmp_path / "params.yaml").write_text(params)
    files = {"body": "body", "out": "clip", "params_file": "params.yaml"}
    return run("clip", scene="tiny", **{key: tmp_path / file for key, file in files.items()})


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, body: Body, start_script: Start) -> Path:
    folder = tmp_path_factory.mktemp("studio")
    body.save(folder / "body")
    result = run_stage(folder, PARAMS, start_script)
    assert result.returncode == 0, result.stderr
    return folder


def test_the_stage_writes_the_clip_and_apart_from_it_the_truth(written: Path):
    clip = Clip.load(written / "clip" / "clip")
    reference = Reference.load(written / "clip" / "reference")
    assert clip.frames.shape == (1, 6, 16, 16, 3)
    assert len(reference.images) == len(reference.frame_indices) > 0
    assert sorted(path.name for path in (written / "clip").iterdir()) == ["clip", "reference"]


def test_a_second_run_in_another_process_writes_the_same_bytes(written: Path):
    before = contents(written / "clip")
    assert run_stage(written, PARAMS).returncode == 0
    assert contents(written / "clip") == before


def test_another_seed_changes_the_first_poses_alone(written: Path):
    clip = Clip.load(written / "clip" / "clip")
    assert run_stage(written, PARAMS.replace("seed: 0", "seed: 1")).returncode == 0
    other = Clip.load(written / "clip" / "clip")
    assert torch.equal(clip.frames, other.frames)
    assert torch.equal(clip.exact.body_pose, other.exact.body_pose)
    assert not torch.equal(clip.initial.body_pose, other.initial.body_pose)


def test_a_window_too_long_is_one_clear_line_and_nothing_is_lost(written: Path):
    before = contents(written / "clip")
    result = run_stage(written, PARAMS.replace("window: 5", "window: 99"))
    assert result.returncode == 1
    assert "ConfigError: clip: no frame is left for training" in result.stderr
    assert "Traceback" not in result.stderr
    assert contents(written / "clip") == before
