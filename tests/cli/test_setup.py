import logging
import subprocess
import sys
from pathlib import Path

import pytest

from deblur_avatar.cli import setup
from deblur_avatar.cli.main import main

ROOT = Path(__file__).parents[2]


@pytest.fixture
def pip(monkeypatch):
    """Stands in for every process that is started."""
    calls, codes = [], {"pip": 0, "-c": 0}

    def run(command, **_):
        calls.append(command[1:])
        kind = "-c" if command[1] == "-c" else "pip"
        return subprocess.CompletedProcess(command, codes[kind], "", "ImportError: no anny")

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setattr(setup, "find_compiler", lambda: ["c++"])
    return calls, codes


def test_two_packages_are_installed_without_their_dependencies_and_proved(pip, caplog):
    with caplog.at_level(logging.INFO):
        assert main(["setup"]) == 0
    wanted = ["-m", "pip", "install", "--no-deps", "mediapipe==0.10.21", "anny==0.6.2"]
    assert pip[0] == [wanted, ["-c", setup.PROOF]]
    assert " ".join(wanted) in caplog.text


def test_a_dry_run_says_it_and_does_nothing(pip, caplog):
    with caplog.at_level(logging.INFO):
        assert main(["setup", "--dry-run"]) == 0
    assert "--no-deps mediapipe==0.10.21 anny==0.6.2" in caplog.text
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
