import dataclasses
import json
import subprocess
from pathlib import Path

import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from tests.stages.running import run_script

PARAMS = """
seed: 0
schedule: small
schedules: {small: {image_height: 12}}
scenes:
  tiny:
    preprocess:
      {poses: given, depth: known, pose_std_degrees: 1.5, masks: given, background: none,
       margin: 0.1, validation_stride: 3}
"""


def tiny_clip(body: Body, frames: int = 5) -> BlurryClip:
    generator = torch.Generator().manual_seed(0)
    pictures = torch.randint(0, 256, (1, frames, 12, 16, 3), generator=generator)
    pictures = pictures.to(torch.uint8)
    poses = Poses(
        betas=torch.zeros(body.shape_dirs.shape[2]),
        global_orient=torch.zeros(frames, 3),
        body_pose=torch.zeros(frames, len(body.parents) - 1, 3),
        transl=torch.tensor([0.0, 0.0, 4.0]).repeat(frames, 1),
    )
    return BlurryClip(
        frames=pictures,
        mattes=pictures[..., 1].contiguous(),
        sharp_frames=pictures[0],
        sharp_mattes=pictures[0, ..., 2].contiguous(),
        recorded=(0,),
        train_camera=0,
        cameras=Cameras(
            Ks=torch.tensor([[[16.0, 0, 8], [0, 16, 6], [0, 0, 1]]]),
            viewmats=torch.eye(4)[None],
            distortion=torch.zeros(1, 5),
            sizes=torch.tensor([[16, 12]]),
            names=("only",),
        ),
        frame_indices=tuple(range(frames)),
        timestamps=torch.arange(frames) / 30.0,
        exposure=1 / 30,
        averaging_space="srgb",
        held_out_from=4,
        initial=poses,
        exact=poses,
    )


def run_stage(folder: Path) -> "subprocess.CompletedProcess[str]":
    (folder / "params.yaml").write_text(PARAMS)
    options = {
        "scene": "tiny",
        "blur": folder / "blur",
        "body": folder / "body",
        "out": folder / "preprocess",
        "metrics": folder / "metrics.json",
        "params_file": folder / "params.yaml",
    }
    return run_script("preprocess", **options)


@pytest.fixture
def folder(tmp_path: Path, body: Body) -> Path:
    body.save(tmp_path / "body")
    tiny_clip(body).save(tmp_path / "blur")
    return tmp_path


def test_the_script_writes_three_sets_of_observations_and_their_metrics(folder: Path):
    done = run_stage(folder)
    assert done.returncode == 0, done.stderr
    for name in ("blurred", "sharp", "exact"):
        observations = Observations.load(folder / "preprocess" / name)
        assert observations.frames.shape == (5, 12, 16, 3)
        # Frame 1 validates, frame 4 is held out; frame 3 is open half a frame into 4's interval.
        assert (observations.train, observations.validation) == ((0, 2, 3), (1,))
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["frames"] == {"total": 5, "without_person": 0, "train": 3, "validation": 1}


def test_what_a_clip_does_not_know_is_an_empty_folder(folder: Path):
    run_stage(folder)
    clip = dataclasses.replace(tiny_clip(Body.load(folder / "body")), exact=None)
    clip.save(folder / "blur")
    assert run_stage(folder).returncode == 0
    assert list((folder / "preprocess" / "exact").iterdir()) == []
    Observations.load(folder / "preprocess" / "sharp")


def test_a_missing_clip_is_one_line_and_nothing_is_written(folder: Path):
    (folder / "blur" / "manifest.json").unlink()
    done = run_stage(folder)
    assert done.returncode == 1
    assert "ArtifactError: no blurry_clip/1" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (folder / "preprocess").exists()
    assert not (folder / "metrics.json").exists()
