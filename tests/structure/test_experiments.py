"""Pipelines of experiments are the one at the root, over scenes of their own."""

import os
import shutil
import subprocess
import sys

import pytest
from dvc.utils.hydra import apply_overrides

from deblur_avatar.config.reading import load_params, read_params
from deblur_avatar.parameters import PlacesParams, check_parameters
from deblur_avatar.pipeline.ablations import SECTIONS
from deblur_avatar.pipeline.clip import ClipParams
from tests.stages.running import run_script
from tests.structure.pipeline_files import (
    PARAMS,
    PIPELINE,
    ROOT,
    experiments,
    paths_in,
    read,
    stages,
)

BOUNDED = ["ceiling", "oracle", "agnostic"]
ZJU = ROOT / "experiments/zju"
WINDOWS = {377: 17, 392: 17, 393: 33, 394: 33, 386: 49, 387: 49}
ABLATIONS = ROOT / "experiments/ablations"
every_experiment = pytest.mark.parametrize("folder", experiments(), ids=lambda path: path.name)


@every_experiment
def test_an_experiment_is_the_pipeline_at_the_root(folder):
    assert (folder / PIPELINE).read_bytes() == (ROOT / PIPELINE).read_bytes(), "run `make code`"


def test_a_pipeline_writes_below_its_folder_alone():
    for stage in stages().values():
        written = paths_in(stage, "outs")
        assert written
        assert not [path for path in written if path.startswith(("/", "..", "${from"))]


@pytest.mark.parametrize("folder", [ROOT, *experiments()], ids=lambda path: path.name)
def test_places_are_where_things_are(folder):
    """`from` says to DVC what `shared` says to the scripts."""
    places, own = load_params(folder / PARAMS, "from", PlacesParams), read(folder / PARAMS)
    up = os.path.relpath(ROOT, folder)
    assert places.root == up
    for section in ("schedules", "avatars", "methods", "check"):
        file = folder / PARAMS
        while section not in read(file):
            file = file.parent / read(file)["shared"]
        assert getattr(places, section) == os.path.relpath(file, folder)
    assert places.bodies == ("data/body" if own["bodies"] else f"{up}/data/body")
    assert places.footage == ("data" if own["scenes"] else f"{up}/data")


@every_experiment
def test_the_parameters_of_an_experiment_are_valid(folder):
    check_parameters(folder / PARAMS)


def test_dvc_understands_every_experiment():
    command = [sys.executable, "-m", "dvc", "stage", "list", "--all", "--name-only"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    listed = set(done.stdout.split())
    for folder in experiments():
        for run in read_params(folder / PARAMS)["runs"]:
            assert f"{folder.relative_to(ROOT)}/{PIPELINE}:evaluate@{run}" in listed


@pytest.mark.parametrize("folder", [ROOT, *experiments()], ids=lambda path: path.name)
def test_dvc_can_set_parameters(folder, tmp_path):
    shutil.copy(folder / PARAMS, tmp_path / PARAMS)
    apply_overrides(str(tmp_path / PARAMS), ["seed=7"])
    assert "seed: 7" in (tmp_path / PARAMS).read_text()


def test_zju_mocap_is_the_six_subjects_of_the_paper():
    content = read_params(ZJU / PARAMS)
    assert content["schedule"] == "full"
    for subject, window in WINDOWS.items():
        scene = content["scenes"][f"zju_{subject}"]
        assert scene["blur"] == {
            "frames": "interpolated", "factor": 8, "window": window, "averaging_space": "srgb",
        }  # fmt: skip
        clip = load_params(ZJU / PARAMS, f"scenes.zju_{subject}.clip", ClipParams)
        assert clip.root == f"$(ZJU_MOCAP_ROOT)/CoreView_{subject}"
        assert (clip.train_camera, clip.test_cameras, clip.test_stride) == (0, "all", 30)
        for method in ("oracle", "agnostic", "paper", "lean"):
            assert content["runs"][f"zju_{subject}-{method}"]["scene"] == f"zju_{subject}"
    assert len(content["scenes"]) == len(WINDOWS)
    frames = {name: scene["clip"]["frames"][1] for name, scene in content["scenes"].items()}
    assert frames == {
        "zju_377": 570, "zju_386": 540, "zju_387": 540, "zju_392": 556, "zju_393": 658,
        "zju_394": 475,
    }  # fmt: skip


def test_no_test_instant_of_zju_mocap_is_set_aside_for_validation():
    for scene in read_params(ZJU / PARAMS)["scenes"].values():
        dropped = (scene["blur"]["window"] // 2 + 7) // scene["blur"]["factor"]
        stride = scene["preprocess"]["validation_stride"]
        tested = range(scene["clip"]["test_stride"], scene["clip"]["frames"][1], 30)
        assert not [frame for frame in tested if (frame - dropped) % stride == stride // 2]


@pytest.mark.parametrize("model", [None, "nowhere/SMPL_NEUTRAL.pkl"])
def test_a_missing_body_is_one_clear_line(tmp_path, model, monkeypatch):
    for name in ("SMPL_MODEL", "ZJU_MOCAP_ROOT"):
        monkeypatch.delenv(name, raising=False)
    if model is not None:
        monkeypatch.setenv("SMPL_MODEL", model)
    done = run_script("body", name="smpl", out=tmp_path / "body", params_file=ZJU / PARAMS)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("ConfigError")
    assert "smpl.is.tue.mpg.de" in done.stderr
    assert ("SMPL_MODEL" if model is None else model) in done.stderr


def test_the_papers_names_of_two_methods_are_known_too():
    methods = read_params(ROOT / PARAMS)["methods"]
    assert methods["no_motion"] == methods["agnostic"]
    assert methods["n5"] == methods["paper"]


def test_the_ablations_are_the_papers_once_a_seed():
    folders = [folder for folder in experiments() if folder.parent == ABLATIONS]
    assert [read_params(folder / PARAMS)["seed"] for folder in folders] == [0, 1, 2]
    (gathered,) = stages(ABLATIONS / PIPELINE).values()
    wanted = {f"experiments/ablations/{folder.name}/metrics" for folder in folders}
    assert wanted == set(paths_in(gathered, "deps"))
    shared = read_params(ABLATIONS / PARAMS)
    assert shared["seeds"] == [folder.name for folder in folders]
    for folder in folders:
        own = read(folder / PARAMS)
        for section in ("schedule", "warmups", "runs"):
            assert own[section] == shared[section]
    methods = {run["method"] for run in shared["runs"].values()}
    assert methods >= {method for section in SECTIONS for method in section.rows}


def test_lean_is_taken_apart_as_it_is_at_the_root():
    root, experiment = read_params(ROOT / PARAMS), read_params(ROOT / "experiments/lean" / PARAMS)
    for section, names in (("avatars", ["lean"]), ("methods", ["lean", *BOUNDED])):
        for name in names:
            assert experiment[section][name] == root[section][name]
    scenes = experiment["scenes"]
    assert scenes == dict.fromkeys(scenes, root["scenes"]["studio"])
    runs = experiment["runs"].values()
    methods = {scene: {r["method"] for r in runs if r["scene"] == scene} for scene in scenes}
    assert len(methods) == 3
    for ran in methods.values():
        assert ran == set(experiment["methods"])


def test_what_stands_in_for_lpips_is_compared_on_the_root_s_avatars():
    root = read_params(ROOT / PARAMS)
    experiment = read_params(ROOT / "experiments/structure" / PARAMS)
    paper = root["avatars"]["paper"]
    paper["losses"]["lpips"] = 0.0
    assert experiment["avatars"]["paper_edges"] == paper
    assert experiment["avatars"]["lean_edges"] == root["avatars"]["lean"]
    assert experiment["methods"]["paper_edges"] == root["methods"]["agnostic"]
    assert experiment["methods"]["lean_edges"] == root["methods"]["lean"]
