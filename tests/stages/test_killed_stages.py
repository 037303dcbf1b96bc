"""A fitting stage that is killed again and again ends with the bytes of one that never was."""

import json
import os
import resource
import subprocess
import sys
from contextlib import contextmanager

import pytest
from ruamel.yaml import YAML

from deblur_avatar.training import resume
from tests.stages.running import ROOT, fitting_options, run_script

KILLS = {"warmup": 17, "trajectory": 17, "fusion": 16}


def killing(whole, stopped):
    """Of each stage: exit status of a run left alone, of the last of the killed ones; how many were
    killed; how many had saved.
    """
    words = [str(whole), str(stopped), "5", *(f"{name}={kills}" for name, kills in KILLS.items())]
    quick = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "tests/stages/killing.py", *words],
        cwd=ROOT, capture_output=True, text=True, check=True, env=os.environ | quick,
    )  # fmt: skip
    rows = [[int(word) for word in line.split()] for line in done.stdout.splitlines()]
    return dict(zip(KILLS, rows, strict=True)), done.stderr


def contents(folder):
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@pytest.fixture(scope="module")
def prepare(tmp_path_factory, observations, tiny_parameters):
    def make():
        folder = tmp_path_factory.mktemp("scene")
        observations.save(folder / "observations")
        ends = {"warmup": 12, "trajectory": 24, "fusion": 36}
        tiny = tiny_parameters["schedules"]["tiny"] | ends
        with (folder / "params.yaml").open("w") as file:
            YAML().dump(tiny_parameters | {"schedules": {"tiny": tiny}, "snapshots": 2}, file)
        return folder

    return make


def test_fifty_kills_at_random_moments_change_no_byte(prepare):
    whole, stopped = prepare(), prepare()
    rows, said = killing(whole, stopped)
    for name, (first, last, _, _) in rows.items():
        assert first == last == 0, said
        assert contents(stopped / name) == contents(whole / name)
        assert (stopped / f"{name}.json").read_bytes() == (whole / f"{name}.json").read_bytes()
        one, other = (json.loads((at / f"{name}_cost.json").read_text()) for at in (whole, stopped))
        assert [s["iteration"] for s in one["snapshots"]] == [
            s["iteration"] for s in other["snapshots"]
        ]
        assert not (stopped / f".{name}.unfinished").exists()
    assert sum(row[2] for row in rows.values()) == 50, "a child failed before all were killed"
    assert sum(row[3] for row in rows.values()) >= 10, "too few children had saved anything"


@contextmanager
def full_disk():
    """No file may grow beyond 20 kB, which no avatar fits into: as a full disk, to this process."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_ends_a_stage_and_leaves_what_was_there(prepare, monkeypatch):
    monkeypatch.setattr(resume, "SAVE_EVERY_S", 0.0)
    folder = prepare()
    options = fitting_options("warmup", folder, folder)
    assert run_script("warmup", **options).returncode == 0
    before = contents(folder / "warmup")
    with full_disk():
        done = run_script("warmup", **options)
    assert done.returncode == 1
    assert "ArtifactError: cannot write" in done.stderr
    assert contents(folder / "warmup") == before
