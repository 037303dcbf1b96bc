"""A sweep on this machine ends as `dvc repro` would, whatever happens on the way."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from deblur_avatar.sweep import local_engine
from deblur_avatar.sweep.costs import REMEMBERED, Costs
from deblur_avatar.sweep.local_engine import LocalEngine
from deblur_avatar.sweep.tasks import Task
from tests.sweep.small_sweep import (
    MORE,
    SWEEP,
    begun,
    called,
    copied,
    process_of,
    results,
    results_of_root,
    swept,
    swept_here,
    tell,
    variables,
)


@pytest.fixture
def project(made, tmp_path) -> Path:
    return copied(made, tmp_path / "swept")


def test_locks_and_artifacts_are_those_of_one_stage_after_the_other(project, serial):
    done = swept(project, "dvc.yaml", MORE, "--at-once", "3")
    assert done.returncode == 0, done.stderr
    assert "14 of 14 tasks done" in done.stdout
    for page in ("reports/index.html", "reports/proof/index.html"):
        assert f"tables and charts: {page}\n" in done.stdout
    assert results(project) == results(serial)
    again = swept_here(project, "dvc.yaml", MORE)
    assert "0 of 0 tasks done" in again.stdout
    assert "up to date" in called(project, "dvc", "repro", "--dry", "-s", "score@root_one")


def test_a_killed_stage_is_begun_again_and_a_failed_one_leaves_the_rest(
    project, serial, monkeypatch
):
    monkeypatch.setenv("SHELL", "/bin/sh")  # DVC's: one that may stay above the stage's process
    tell(project, "fit-root_one", "die once")
    tell(project, "fit-root_two", "fail")
    done = swept(project, "dvc.yaml", "--at-once", "2")
    assert done.returncode == 1
    assert "the cloth is torn" in done.stdout
    assert "failed: fit@root_two" in done.stdout
    assert "left, since it needs one that failed: score@root_two" in done.stdout
    assert begun(project, "root_one") == ["fit", "fit", "score"]
    assert begun(project, "root_two") == ["fit"]
    tell(project, "fit-root_two", "")
    assert "3 of 3 tasks done" in swept(project, "dvc.yaml").stdout
    assert results(project).keys() == results_of_root(serial).keys()


SLOW = "score@root_three"


def waiting_sweep(project: Path) -> "subprocess.Popen[str]":
    """A sweep of `SLOW`, whose fit waits, once that one has begun."""
    tell(project, "fit-root_three", "wait")
    process = subprocess.Popen(
        [*SWEEP, SLOW], cwd=project, text=True,
        env=variables(),
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    while not (project / "begun" / "root_three").exists():
        assert process.poll() is None, process.communicate()[0]
        time.sleep(0.1)
    return process


def gone(process: int, seconds: float = 100.0) -> bool:
    """Whether a process ends, waited for as long as a busy machine may need."""
    until = time.monotonic() + seconds
    while True:
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        if time.monotonic() >= until:
            return False
        time.sleep(0.1)


def test_a_second_sweep_is_refused_and_a_stopped_one_goes_on(project):
    process = waiting_sweep(project)
    second = swept_here(project, "dvc.yaml")
    assert second.returncode == 1
    assert "another sweep works in" in second.stderr
    os.kill(process.pid, signal.SIGINT)
    said, _ = process.communicate()
    assert process.returncode == 130, said
    assert gone(process_of(project, "root_three"))
    tell(project, "fit-root_three", "")
    done = swept(project, SLOW)
    assert done.returncode == 0, done.stderr
    assert begun(project, "root_three")[-2:] == ["fit", "score"]
    assert "up to date" in called(project, "dvc", "repro", "--dry", "-s", "score@root_three")


def test_a_stage_that_does_not_hear_the_keyboard_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr(local_engine, "PATIENCE", 0.5)
    deaf = (
        "import os, pathlib, signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); "
        "pathlib.Path('process').write_text(f'{os.getpid()} '); time.sleep(600)"
    )
    engine = LocalEngine(tmp_path, 1, 1000.0, variables())
    engine.start(Task("deaf", frozenset(), 1.0, 1.0, 1, (sys.executable, "-c", deaf)))
    said = tmp_path / "process"
    while not (said.exists() and said.read_text().endswith(" ")):
        assert engine.wait(0.1) is None
    assert not gone(int(said.read_text()), seconds=0)
    engine.stop()
    assert gone(int(said.read_text()))


def test_nothing_is_left_running_when_the_sweep_is_killed(project):
    process = waiting_sweep(project)
    process.kill()
    process.wait()
    assert gone(process_of(project, "root_three"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["experiments/none/"], "not found inside"),
        (["stages"], "no dvc.yaml in stages"),
        (["dvc.yaml", "--address", "auto"], "say --engine ray"),
        (["dvc.yaml", "--at-once", "0"], "--at-once: wanted 1 or more, got 0"),
        (["dvc.yaml", "--retries", "-1"], "--retries: wanted 0 or more, got -1"),
        (["dvc.yaml", "--plan", "0"], "--plan: wanted numbers of workers from 1, got 0"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_1(project, words, said):
    done = swept_here(project, *words)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("ConfigError: ")
    assert said in done.stderr


def test_a_plan_says_what_it_takes_and_runs_nothing(project):
    (project / REMEMBERED).parent.mkdir(parents=True, exist_ok=True)
    (project / REMEMBERED).write_text(json.dumps({"fit@root_one": 3600.0, "score@x": 97.0}))
    done = swept_here(project, "dvc.yaml", "--plan", "1", "4")
    assert done.returncode == 0, done.stderr
    assert "9 tasks; the longest chain of them takes 1.04 hours." in done.stdout
    assert done.stdout.count("\n|") + done.stdout.startswith("|") == 4
    assert not (project / "begun").exists()


def test_costs_are_remembered_measured_of_the_like_or_guessed(tmp_path):
    costs = Costs(tmp_path)
    assert costs.of("p/dvc.yaml:fit@a", []).seconds == 30.0
    said = tmp_path / "metrics/cost/fit/a.json"
    said.parent.mkdir(parents=True)
    said.write_text('{"seconds": 12.5, "peak_memory_mb": 400.0}')
    assert costs.of("p/dvc.yaml:fit@a", [said]).memory_mb == 400.0
    assert costs.of("p/dvc.yaml:fit@a", [said]).seconds == 12.5
    costs.remember({"p/dvc.yaml:fit@b": 20.04})
    again = Costs(tmp_path)
    assert again.of("p/dvc.yaml:fit@b", []).seconds == 20.0
    assert again.of("q/dvc.yaml:fit@c", []).seconds == 20.0
    assert again.of("p/dvc.yaml:score@c", []).seconds == 30.0
    (tmp_path / REMEMBERED).write_text("{")
    assert Costs(tmp_path).remembered == {}


def test_without_ray_the_answer_is_what_to_install(project, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "deblur_avatar.sweep.ray_engine", raising=False)
    done = swept_here(project, "dvc.yaml", "--engine", "ray")
    assert done.returncode == 1
    assert "pip install 'deblur-avatar[cluster]'" in done.stderr
