from pathlib import Path

import pytest
import torch

from deblur_avatar.artifacts import Body
from deblur_avatar.config import ClipParams, MultiviewParams, parse, read_yaml
from deblur_avatar.errors import ConfigError
from deblur_avatar.fitting.landmarks import Landmarks
from deblur_avatar.pipeline import clip as stage
from deblur_avatar.pipeline.clip import load_clip

SCENES = read_yaml(Path(__file__).parents[2] / "params.yaml")["scenes"]


def nobody(frames: torch.Tensor) -> Landmarks:
    raise AssertionError("the studio knows its mattes")


def test_a_studio_scene_is_filmed(body: Body):
    tiny = {"frames": 4, "image_size": 8, "window": 1, "test_cameras": 1, "samples_per_axis": 1}
    params = parse(ClipParams, {**SCENES["studio"]["clip"], **tiny}, "scenes.studio.clip")
    clip, reference = load_clip(params, body, detect=nobody, generator=torch.Generator())
    assert clip.frames.shape == (1, 4, 8, 8, 3)
    assert set(reference.camera_indices.tolist()) == {1}


def test_real_footage_is_read_with_the_detectors_mattes(
    body: Body, monkeypatch: pytest.MonkeyPatch
):
    mattes = torch.full((2, 3, 4), 7, dtype=torch.uint8)
    found = Landmarks(
        found=torch.ones(2, dtype=torch.bool),
        points=torch.zeros(2, 33, 2),
        visibility=torch.zeros(2, 33),
        mattes=mattes,
    )
    monkeypatch.setattr(stage, "load_multiview", lambda params, segment: (params, segment))
    params = parse(ClipParams, SCENES["courtyard"]["clip"], "scenes.courtyard.clip")
    read, segment = load_clip(params, body, detect=lambda _: found, generator=torch.Generator())
    assert isinstance(read, MultiviewParams)
    assert torch.equal(segment(torch.zeros(2, 3, 4, 3, dtype=torch.uint8)), mattes)


def test_footage_that_is_not_there_is_refused(body: Body, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("POSE2SIM_ROOT", "/nowhere")
    params = parse(ClipParams, SCENES["courtyard"]["clip"], "scenes.courtyard.clip")
    with pytest.raises(ConfigError, match="POSE2SIM_ROOT"):
        load_clip(params, body, detect=nobody, generator=torch.Generator())
