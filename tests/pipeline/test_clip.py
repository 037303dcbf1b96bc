import importlib.util
from pathlib import Path
from typing import Literal

import pytest
import torch
from ruamel.yaml import YAML

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.body_estimation.landmarks import Landmarks
from deblur_avatar.config.reading import parse, read_yaml
from deblur_avatar.config.section import Count, Params
from deblur_avatar.errors import ConfigError
from deblur_avatar.pipeline.clip import ClipParams, load_clip
from deblur_avatar.sources.registry import SOURCES
from deblur_avatar.sources.source import Segment, Source

ROOT = Path(__file__).parents[2]
SCENES = read_yaml(ROOT / "params.yaml")["scenes"]


def tiny_studio() -> Source:
    tiny = {"frames": 4, "image_size": 8, "window": 1, "test_cameras": 1, "samples_per_axis": 1}
    return parse(ClipParams, {**SCENES["studio"]["clip"], **tiny}, "scenes.studio.clip")


def nobody(frames: torch.Tensor) -> Landmarks:
    raise AssertionError("the studio knows its mattes")


class UpsideDownParams(Params):
    """The studio's clip with its pictures' rows upside down: a source that this file adds."""

    source: Literal["upside_down"]
    frames: Count

    def load(
        self, body: Body, segment: Segment, generator: torch.Generator
    ) -> tuple[Clip, Reference]:
        clip, reference = tiny_studio().load(body, segment, generator)
        segment(clip.frames[0])
        clip.frames[:] = clip.frames.flip(2)
        return clip, reference

    def missing_files(self, where: str) -> tuple[str, ...]:
        return (f"nobody hangs from the ceiling ({where})",)


def test_a_studio_scene_is_filmed(body: Body):
    clip, reference = load_clip(tiny_studio(), body, detect=nobody, generator=torch.Generator())
    assert clip.frames.shape == (1, 4, 8, 8, 3)
    assert set(reference.camera_indices.tolist()) == {1}


@pytest.mark.parametrize("name", SOURCES)
def test_every_kind_is_a_source(name: str):
    assert all(callable(getattr(SOURCES[name], method)) for method in ("load", "missing_files"))
    assert SOURCES[name].model_fields["source"].annotation == Literal[name]


def test_a_new_source_is_a_class_and_a_line(
    body: Body, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    """It runs through the script of the stage, with the detector's mattes and nothing else."""
    monkeypatch.setitem(SOURCES, "upside_down", UpsideDownParams)
    found = Landmarks(
        found=torch.ones(4, dtype=torch.bool),
        points=torch.zeros(4, 33, 2),
        visibility=torch.zeros(4, 33),
        mattes=torch.full((4, 8, 8), 7, dtype=torch.uint8),
    )
    asked = []
    monkeypatch.setattr(
        "deblur_avatar.body_estimation.landmarks.detect_with_mediapipe",
        lambda frames: asked.append(frames.shape) or found,
    )
    body.save(tmp_path / "body")
    section = {"source": "upside_down", "frames": 4}
    with (tmp_path / "params.yaml").open("w") as file:
        YAML().dump({"seed": 0, "scenes": {"mine": {"clip": section}}}, file)
    spec = importlib.util.spec_from_file_location("clip_script", ROOT / "stages/clip.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.main("mine", tmp_path / "body", tmp_path / "out", tmp_path / "params.yaml")
    assert asked == [(4, 8, 8, 3)]
    upright, _ = load_clip(tiny_studio(), body, detect=nobody, generator=torch.Generator())
    assert torch.equal(Clip.load(tmp_path / "out/clip").frames, upright.frames.flip(2))


def test_footage_that_is_not_there_is_refused(body: Body, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("POSE2SIM_ROOT", "/nowhere")
    params = parse(ClipParams, SCENES["courtyard_mono"]["clip"], "scenes.courtyard_mono.clip")
    reason = "no folder /nowhere (scenes.courtyard_mono.clip.root)"
    assert params.missing_files("scenes.courtyard_mono.clip") == (reason,)
    with pytest.raises(ConfigError, match="POSE2SIM_ROOT"):
        load_clip(params, body, detect=nobody, generator=torch.Generator())
