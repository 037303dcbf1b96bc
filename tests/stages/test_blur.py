import json
import subprocess
from pathlib import Path

import torch

from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.clip import BlurryClip, Clip
from tests.stages.running import run_script

PARAMS = """
seed: 0
scenes:
  tiny:
    blur: {frames: interpolated, factor: 2, window: 3, averaging_space: srgb}
"""


def tiny_clip() -> Clip:
    generator = torch.Generator().manual_seed(0)
    frames = torch.randint(0, 256, (1, 5, 6, 8, 3), generator=generator, dtype=torch.uint8)
    return Clip(
        frames=frames,
        mattes=frames[..., 0].contiguous(),
        recorded=(0,),
        train_camera=0,
        cameras=Cameras(
            Ks=torch.tensor([[[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]]),
            viewmats=torch.eye(4)[None],
            distortion=torch.zeros(1, 5),
            sizes=torch.tensor([[8, 6]]),
            names=("only",),
        ),
        timestamps=torch.arange(5) / 30.0,
        blurred=False,
        exposure=None,
        averaging_space="srgb",
        held_out_from=4,
        initial=None,
        exact=None,
        true_blur_srgb=None,
        true_blur_linear=None,
        true_blur_mattes=None,
        frame_indices=None,
        true_blur_exposure=None,
    )


def run_stage(folder: Path, params: str) -> "subprocess.CompletedProcess[str]":
    (folder / "params.yaml").write_text(params)
    options = {
        "scene": "tiny",
        "clip": folder / "clip",
        "out": folder / "blur",
        "params_file": folder / "params.yaml",
    }
    return run_script("blur", **options)


def test_the_stage_blurs_a_few_pixels(tmp_path):
    tiny_clip().save(tmp_path / "clip")
    done = run_stage(tmp_path, PARAMS)
    assert done.returncode == 0, done.stderr
    blurry = BlurryClip.load(tmp_path / "blur")
    assert blurry.frame_indices == (1, 2, 3)
    assert blurry.held_out_from == 3
    options = {
        "scene": "tiny",
        "clip": tmp_path / "clip",
        "blurred": tmp_path / "blur",
        "metrics": tmp_path / "metrics.json",
        "params_file": tmp_path / "params.yaml",
    }
    done = run_script("score_blur", **options)
    assert done.returncode == 0, done.stderr
    measured = json.loads((tmp_path / "metrics.json").read_text())
    assert measured["scene"] == "tiny"
    assert measured["frames"]["kept"] == 3
    assert abs(measured["exposure_ms"] - 50) < 0.01


def test_an_even_window_ends_with_one_line_and_no_output(tmp_path):
    tiny_clip().save(tmp_path / "clip")
    done = run_stage(tmp_path, PARAMS.replace("window: 3", "window: 4"))
    assert done.returncode == 1
    assert "ConfigError: blur.window: a window centred on a frame is odd, got 4" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "blur").exists()
