"""Tests of the benchmark of viewing while fitting: what it counts, stops and leaves behind."""

import json
import os
import subprocess
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from benchmarks.view_while_fitting import (
    RUN,
    descendants,
    speed,
    stopped,
    summary,
    write_folder,
)
from deblur_avatar.cli.run_on_disk import RunOnDisk

ROOT = Path(__file__).parents[2]


def test_a_viewer_finds_the_run(tmp_path, make_observations):
    make_observations().save(tmp_path / "seen")
    write_folder(tmp_path / "run", tmp_path / "seen")
    assert len(RunOnDisk(tmp_path / "run", RUN).observations().frames) == 5


def test_speed_counts_the_steps_of_the_time_after_the_switch():
    step, passed = SimpleNamespace(value=0), []

    def let_pass(seconds):
        step.value += 7 if passed else 1000
        passed.append(seconds)
        time.sleep(0.01)

    assert 0 < speed(step, let_pass, 0.01) <= 700
    assert len(passed) == 2


def test_shares_are_of_means_of_all_rounds():
    rows = [
        {"alone": 100.0, "watched": 90.0, "browser": 50.0, "both": 45.0},
        {"alone": 200.0, "watched": 150.0, "browser": 150.0, "both": 75.0},
    ]
    shares = summary(rows)
    assert shares["share_watched"] == pytest.approx(0.8)
    assert shares["share_beside_browser"] == pytest.approx(0.6)
    assert shares["share_with_browser"] == pytest.approx(0.4)


def test_processes_stand_still_and_go_on():
    def state():
        return Path(f"/proc/{sleeping.pid}/stat").read_text().rpartition(")")[2].split()[0]

    with subprocess.Popen(["sleep", "60"]) as sleeping:
        try:
            assert sleeping.pid in descendants(os.getpid())
            with stopped([sleeping.pid]):
                os.waitid(os.P_PID, sleeping.pid, os.WSTOPPED)
                assert state() == "T"
            os.waitid(os.P_PID, sleeping.pid, os.WCONTINUED)
            assert state() != "T"
        finally:
            sleeping.kill()


def test_the_record_says_what_the_documents_say():
    (path,) = (ROOT / "benchmarks/results").glob("view_while_fitting_*.json")
    record = json.loads(path.read_text())
    again = summary(record["turns"])
    assert {name: record[name] for name in again} == pytest.approx(again, rel=1e-5)
    text = (ROOT / "docs/exports.md").read_text()
    assert f"{100 * record['share_watched']:.0f} % of its speed" in text
