from pathlib import Path

import pytest
import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.config.reading import parse, read_yaml
from deblur_avatar.errors import ConfigError
from deblur_avatar.pipeline import clip as stage
from deblur_avatar.pipeline.clip import ClipParams, load_clip
from deblur_avatar.sources.multiview import Segment
from deblur_avatar.sources.studio.params import StudioParams

SCENES = read_yaml(Path(__file__).parents[2] / "params.yaml")["scenes"]


def tiny_studio() -> StudioParams:
    tiny = {"frames": 4, "image_size": 8, "window": 1, "test_cameras": 1, "samples_per_axis": 1}
    return parse(ClipParams, {**SCENES["studio"]["clip"], **tiny}, "scenes.studio.clip")


def nobody(frames: torch.Tensor) -> Landmarks:
    raise AssertionError("the studio knows its mattes")


def test_a_studio_scene_is_filmed(body: Body):
    clip, reference = load_clip(tiny_studio(), body, detect=nobody, generator=torch.Generator())
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
    footage = load_clip(tiny_studio(), body, detect=nobody, generator=torch.Generator())
    asked = []

    def load(params: object, segment: Segment) -> tuple[Clip, Reference]:
        asked.append((params, segment(torch.zeros(2, 3, 4, 3, dtype=torch.uint8))))
        return footage

    monkeypatch.setattr(stage, "load_multiview", load)
    params = parse(ClipParams, SCENES["courtyard"]["clip"], "scenes.courtyard.clip")
    read = load_clip(params, body, detect=lambda _: found, generator=torch.Generator())
    assert read is footage
    assert asked[0][0] is params
    assert torch.equal(asked[0][1], mattes)


def test_footage_that_is_not_there_is_refused(body: Body, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("POSE2SIM_ROOT", "/nowhere")
    params = parse(ClipParams, SCENES["courtyard"]["clip"], "scenes.courtyard.clip")
    with pytest.raises(ConfigError, match="POSE2SIM_ROOT"):
        load_clip(params, body, detect=nobody, generator=torch.Generator())
