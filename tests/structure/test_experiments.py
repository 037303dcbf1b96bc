"""Pipelines of experiments are the one at the root, over scenes of their own."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from dvc.utils.hydra import apply_overrides
from ruamel.yaml import YAML
from tests.structure.experiments import (
    PARAMS,
    PIPELINE,
    ROOT,
    experiments,
    pipeline,
    write_pipelines,
)
from tests.structure.import_closure import (
    code_dependencies,
    is_code,
    own_pipelines,
    script_of,
    stages,
)

from deblur_avatar.config.reading import load_params, read_params
from deblur_avatar.pipeline.ablations import SECTIONS
from deblur_avatar.pipeline.clip import ClipParams
from deblur_avatar.pipeline.parameters import check_parameters

BOUNDED = ["ceiling", "oracle", "agnostic"]
ZJU = ROOT / "experiments/zju"
WINDOWS = {377: 17, 392: 17, 393: 33, 394: 33, 386: 49, 387: 49}
ABLATIONS = ROOT / "experiments/ablations"
every_experiment = pytest.mark.parametrize("folder", experiments(), ids=lambda path: path.name)


def resolved(folder):
    content = YAML(typ="safe", pure=True).load(folder / PIPELINE)
    return {name: stage.get("do", stage) for name, stage in content["stages"].items()}


@every_experiment
def test_an_experiment_is_the_pipeline_at_the_root(folder):
    assert (folder / PIPELINE).read_text() == pipeline(folder), "run `make deps`"
    assert set(resolved(folder)) == set(read_params(folder / PARAMS).get("stages", stages()))


@every_experiment
def test_an_experiment_writes_below_its_folder_alone(folder):
    name = str(folder.relative_to(ROOT))
    for stage in resolved(folder).values():
        written = [next(iter(out)) if isinstance(out, dict) else out for out in stage["outs"]]
        assert all(path.startswith(f"{name}/") for path in written)
        reads = {path for path in stage["deps"] if not is_code(path)}
        foreign = re.findall(r"(?<![\w/-])(?:data|metrics|reports|params\.yaml)\S*", stage["cmd"])
        assert set(foreign) <= reads  # what the root's pipeline makes, where it is not made here


@every_experiment
def test_the_parameters_of_an_experiment_are_valid(folder):
    check_parameters(folder / PARAMS)


@every_experiment
def test_dvc_understands_an_experiment(folder):
    command = [sys.executable, "-m", "dvc", "stage", "list", f"{folder.relative_to(ROOT)}/dvc.yaml"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for run in read_params(folder / PARAMS)["runs"]:
        assert f"evaluate@{run}" in done.stdout


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
            "frames": "interpolated", "factor": 8, "window": window, "light": "srgb",
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
def test_a_missing_body_is_one_clear_line(tmp_path, model):
    environment = {k: v for k, v in os.environ.items() if k not in ("SMPL_MODEL", "ZJU_MOCAP_ROOT")}
    environment |= {} if model is None else {"SMPL_MODEL": model}
    command = [sys.executable, "stages/body.py", "--name", "smpl", "--out", str(tmp_path / "body")]
    command += ["--params-file", str(ZJU / PARAMS)]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("ConfigError")
    assert "smpl.is.tue.mpg.de" in done.stderr
    assert ("SMPL_MODEL" if model is None else model) in done.stderr


def test_pipelines_that_gather_experiments_depend_on_the_code_they_run():
    gathering = own_pipelines()[1:]
    suite = [ROOT / "stability" / method for method in ("agnostic", "", "lean", "paper")]
    assert gathering == [folder / PIPELINE for folder in (ABLATIONS, *suite)]
    for path in gathering:
        for stage in resolved(path.parent).values():
            assert [d for d in stage["deps"] if is_code(d)] == code_dependencies(script_of(stage))


def test_the_papers_names_of_two_methods_are_known_too():
    methods = read_params(ROOT / PARAMS)["methods"]
    assert methods["no_motion"] == methods["agnostic"]
    assert methods["n5"] == methods["paper"]


def test_the_ablations_are_the_papers_once_a_seed():
    folders = [folder for folder in experiments() if folder.parent == ABLATIONS]
    assert [read_params(folder / PARAMS)["seed"] for folder in folders] == [0, 1, 2]
    (gathered,) = resolved(ABLATIONS).values()
    wanted = {f"experiments/ablations/{folder.name}/metrics" for folder in folders}
    assert wanted == {dep for dep in gathered["deps"] if not is_code(dep)}
    methods = {run["method"] for run in read_params(folders[0] / PARAMS)["runs"].values()}
    assert methods >= {method for section in SECTIONS for method in section.rows}
    stage = resolved(folders[1])["trajectory"]
    assert stage["params"][0] == {"experiments/ablations/seed_1/params.yaml": ["seed"]}
    assert "data/preprocess/${item.scene}/${item.observations}" in stage["deps"]
    assert "experiments/ablations/seed_1/data/trajectory/${key}" in stage["outs"]


def test_a_pipeline_follows_the_root_and_its_own_parameters(tmp_path: Path):
    (tmp_path / "experiments/small").mkdir(parents=True)
    (tmp_path / "experiments/small/params.yaml").write_text("seed: 1\nscenes: {}\n")
    (tmp_path / "dvc.yaml").write_text(
        "stages:\n  cut:\n    foreach: ${scenes}\n    do:\n"
        "      cmd: python stages/cut.py --metrics metrics/${key}.json --params-file params.yaml\n"
        "      deps: [stages/cut.py, 'data/raw/${key}']\n"
        "      params: [seed, 'methods.${item.method}']\n"
        "      outs: ['data/cut/${key}', 'metrics/${key}.json': {cache: false}]\n"
    )
    assert write_pipelines(tmp_path) == ["experiments/small/dvc.yaml"]
    assert write_pipelines(tmp_path) == []
    stage = resolved(tmp_path / "experiments/small")["cut"]
    assert stage["wdir"] == "../.."
    assert stage["cmd"] == (
        "python stages/cut.py --metrics experiments/small/metrics/${key}.json "
        "--params-file experiments/small/params.yaml"
    )
    assert stage["deps"] == ["stages/cut.py", "experiments/small/data/raw/${key}"]
    own, shared = stage["params"]
    assert own == {"experiments/small/params.yaml": ["seed"]}
    assert shared == "methods.${item.method}"
    assert stage["outs"][1] == {"experiments/small/metrics/${key}.json": {"cache": False}}


@pytest.mark.parametrize("bodies", ["", "bodies: {}\n"])
def test_bodies_are_the_root_s_unless_a_folder_has_its_own(tmp_path: Path, bodies: str):
    folder = tmp_path / "experiments/small"
    folder.mkdir(parents=True)
    (folder / "params.yaml").write_text(f"seed: 1\nscenes: {{}}\n{bodies}")
    (tmp_path / "dvc.yaml").write_text(
        "stages:\n"
        "  body:\n    cmd: body --out data/body\n    deps: []\n"
        "    params: [bodies]\n    outs: [data/body]\n"
        "  cut:\n    cmd: cut --body data/body --a-metrics data/cut\n    deps: [data/body]\n"
        "    params: [scenes.one, methods.a]\n    outs: [data/cut]\n"
    )
    write_pipelines(tmp_path)
    made = resolved(folder)
    assert set(made) == ({"body", "cut"} if bodies else {"cut"})
    body = "experiments/small/data/body" if bodies else "data/body"
    cut = made["cut"]
    assert cut["cmd"] == f"cut --body {body} --a-metrics experiments/small/data/cut"
    assert cut["deps"] == [body]
    assert cut["params"] == [{"experiments/small/params.yaml": ["scenes.one"]}, "methods.a"]
    assert cut["outs"] == ["experiments/small/data/cut"]


def test_lean_is_taken_apart_as_it_is_at_the_root():
    root, experiment = read_params(ROOT / PARAMS), read_params(ROOT / "experiments/lean" / PARAMS)
    for section, names in (("starts", ["lean"]), ("methods", ["lean", *BOUNDED])):
        for name in names:
            assert experiment[section][name] == root[section][name]
    scenes = experiment["scenes"]
    assert scenes == dict.fromkeys(scenes, root["scenes"]["studio"])
    runs = experiment["runs"].values()
    methods = {scene: {r["method"] for r in runs if r["scene"] == scene} for scene in scenes}
    assert len(methods) == 3
    for ran in methods.values():
        assert ran == set(experiment["methods"])


def test_what_stands_in_for_lpips_is_compared_on_the_root_s_starts():
    root = read_params(ROOT / PARAMS)
    experiment = read_params(ROOT / "experiments/structure" / PARAMS)
    paper = root["starts"]["paper"]
    paper["losses"]["lpips"] = 0.0
    assert experiment["starts"]["paper_edges"] == paper
    assert experiment["starts"]["lean_edges"] == root["starts"]["lean"]
    assert experiment["methods"]["paper_edges"] == root["methods"]["agnostic"]
    assert experiment["methods"]["lean_edges"] == root["methods"]["lean"]
