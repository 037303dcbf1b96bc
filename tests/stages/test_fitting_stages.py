"""The three fitting stages, run as DVC runs them: one process each, on a few pixels."""

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.checkpoint import Checkpoint
from deblur_avatar.artifacts.motion import Motion
from tests.stages.running import BEFORE, fitting_options, run_script

STAGES = ("warmup", "trajectory", "fusion")


def write_params(folder: Path, content: dict[str, Any]) -> None:
    with (folder / "params.yaml").open("w") as file:
        YAML().dump(content, file)


@pytest.fixture(scope="module")
def tiny(tiny_parameters):
    return copy.deepcopy(tiny_parameters)


@pytest.fixture(scope="module")
def chain(tmp_path_factory, observations, tiny, start_script):
    """All three stages, one after the other, each in its own process."""
    folder = tmp_path_factory.mktemp("chain")
    observations.save(folder / "observations")
    write_params(folder, tiny)
    return folder, {
        stage: start_script(stage, **fitting_options(stage, folder, folder)) for stage in STAGES
    }


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_runs_and_says_so_in_two_lines_and_its_losses(chain, stage):
    folder, runs = chain
    done = runs[stage]
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    first, *losses, last = done.stderr.splitlines()
    assert first.startswith(f"{stage} {stage}: start, device ")
    assert last.startswith(f"{stage} {stage}: done in ")
    assert all(f"{stage} {stage} " in line and "l1 0." in line for line in losses)
    cost = json.loads((folder / f"{stage}_cost.json").read_text())
    assert cost["seconds"] > 0
    assert cost["peak_memory_mb"] > 50
    measured = json.loads((folder / f"{stage}.json").read_text())
    assert not cost.keys() & measured.keys()


def test_each_stage_writes_what_the_next_one_reads(chain, tiny):
    folder, _ = chain
    ends = tiny["schedules"]["tiny"]
    for stage in STAGES:
        avatar = Avatar.load(folder / stage / "avatar")
        assert avatar.iteration == ends[stage]
        measured = json.loads((folder / f"{stage}.json").read_text())
        assert measured["gaussians"] == len(avatar.means)
    for stage in ("warmup", "trajectory"):
        assert Checkpoint.load(folder / stage / "checkpoint").iteration == ends[stage]
    motion = Motion.load(folder / "fusion" / "motion")
    assert motion.kind == "pair"
    assert motion.body_pose.shape == (5, 5, 23, 3)
    for stage, parts in (("warmup", 2), ("trajectory", 3), ("fusion", 2)):
        assert len(list((folder / stage).iterdir())) == parts


def files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.parametrize("stage", STAGES)
def test_a_second_run_in_another_process_writes_the_same_bytes(chain, tiny, stage, tmp_path):
    folder, _ = chain
    write_params(tmp_path, tiny)
    done = run_script(stage, **fitting_options(stage, tmp_path, folder))
    assert done.returncode == 0, done.stderr
    assert files(tmp_path / stage) == files(folder / stage)


def misspell(content: dict[str, Any], stage: str) -> str:
    """Misspell a key that the stage reads; returns the section it is in."""
    if stage == "warmup":
        section, where = content["avatars"]["paper"]["losses"], "avatars.paper"
    else:
        section, where = content["methods"]["paper"][stage], f"methods.paper.{stage}"
    key = list(section)[1]  # the first names the kind
    section[f"{key}s"] = section.pop(key)
    return where


def test_a_typo_in_the_parameters_ends_with_one_line_and_no_output(
    chain, tiny, tmp_path, start_script
):
    folder, _ = chain
    content = copy.deepcopy(tiny)
    where = misspell(content, "warmup")
    write_params(tmp_path, content)
    done = start_script("warmup", **fitting_options("warmup", tmp_path, folder))
    assert done.returncode == 1
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"ConfigError: {tmp_path / 'params.yaml'}: {where}: missing key")
    assert "unknown key" in line
    assert [path.name for path in tmp_path.iterdir()] == ["params.yaml"]


def refused(stage, folder, read) -> list[str]:
    """The lines that a stage says that ends with exit code 1."""
    done = run_script(stage, **fitting_options(stage, folder, read))
    assert done.returncode == 1
    return done.stderr.splitlines()


@pytest.mark.parametrize("stage", ["trajectory", "fusion"])
def test_a_typo_in_a_method_does_too(chain, tiny, stage, tmp_path):
    folder, _ = chain
    content = copy.deepcopy(tiny)
    where = misspell(content, stage)
    write_params(tmp_path, content)
    (line,) = refused(stage, tmp_path, folder)
    assert line.startswith(f"ConfigError: {tmp_path / 'params.yaml'}: {where}: missing key")
    assert "unknown key" in line
    assert [path.name for path in tmp_path.iterdir()] == ["params.yaml"]


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_before_its_predecessor_says_what_to_do(chain, tiny, stage, tmp_path):
    folder, _ = chain
    write_params(tmp_path, tiny)
    missing, schema = tmp_path / "observations", "observations/4"
    if stage in BEFORE:
        missing.symlink_to(folder / "observations")
        missing, schema = tmp_path / BEFORE[stage] / "avatar", "avatar/1"
    start, line = refused(stage, tmp_path, tmp_path)
    assert start.startswith(f"{stage} {stage}: start, device ")
    assert line == f"ArtifactError: no {schema} in {missing}; run `dvc repro` or `dvc pull`"
    assert not (tmp_path / stage).exists()
