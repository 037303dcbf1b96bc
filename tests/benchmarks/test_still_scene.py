"""The benchmark of a still scene, on a tiny one: turns, what is counted, and the ratio."""

from dataclasses import replace

import pytest
import torch

from benchmarks.still_scene import METHODS, PARAMETERS, filmed, in_turns, seen, summary
from benchmarks.stress.fit import FitSetup
from benchmarks.stress.params import StabilitySceneParams
from benchmarks.stress.scene import film_scene
from deblur_avatar.config.reading import load_params
from deblur_avatar.training.schedule import ScheduleParams
from tests.structure.pipeline_files import ROOT

SCHEDULE = ScheduleParams(
    warmup=3, trajectory=6, fusion=9, gaussians=100, image_height=32, levels=()
)


@pytest.fixture(scope="module")
def clip():
    scene = load_params(ROOT / PARAMETERS, "scenes.still", StabilitySceneParams)
    small = {"frames": 12, "image_size": 32, "test_cameras": 1, "window": 17, "samples_per_axis": 1}
    tiny = scene.model_copy(update={"clip": scene.clip.model_copy(update=small)})
    return film_scene(tiny, torch.Generator().manual_seed(0))[1]


@pytest.fixture(scope="module")
def setups():
    cpu = torch.device("cpu")
    chosen = {name: FitSetup.of(name, ROOT / PARAMETERS, 0, cpu) for name in METHODS}
    return {name: replace(setup, schedule=SCHEDULE) for name, setup in chosen.items()}


def test_both_methods_are_fitted_in_turns_and_the_ratio_is_that_of_their_seconds(clip, setups):
    observations = seen(clip, setups["lean"], disturbed=False)
    fits = in_turns(observations, setups, 2)
    numbers = summary(observations, fits)
    for name in METHODS:
        row = numbers[name]
        assert row["processor_s"] == [round(fitted.processor_s, 3) for fitted in fits[name]]
        assert row["shortest_s"] == min(row["processor_s"]) > 0
        assert len(row["gaussians"]) == len(row["psnr_validation"]) == 2
    ratio = numbers["lean"]["shortest_s"] / numbers["agnostic"]["shortest_s"]
    assert numbers["ratio_of_shortest"] == pytest.approx(ratio, abs=1e-3)
    assert numbers["lean"]["virtual_poses"] == [1.0, 1.0]


def test_poses_are_exact_unless_they_are_to_be_disturbed(clip, setups):
    exact, disturbed = (
        seen(clip, setups["lean"], disturbed=disturbed).poses.body_pose
        for disturbed in (False, True)
    )
    assert not torch.equal(exact, disturbed)
    assert float(exact.diff(dim=0).abs().max()) < 1e-6


def test_a_film_that_was_kept_is_not_filmed_again(clip, tmp_path, monkeypatch):
    clip.save(tmp_path / "still")
    monkeypatch.setattr("benchmarks.still_scene.film_scene", None)
    assert torch.equal(filmed("still", tmp_path).frames, clip.frames)
