"""A fitting stage that is killed again and again ends with the bytes of one that never was."""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[2]
KILLS = {"warmup": 17, "trajectory": 17, "fusion": 16}


def killing(name, whole, stopped, kills, **options):
    """Exit status of a run left alone and of the last of the killed ones; kills; saves found."""
    words = [name, str(whole), str(stopped), str(kills), "5"]
    quick = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "tests/stages/killing.py", *words],
        cwd=ROOT, capture_output=True, text=True, check=True, env=os.environ | quick, **options,
    )  # fmt: skip
    return [int(word) for word in done.stdout.split()], done.stderr


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
    killed, saved = 0, 0
    for name, kills in KILLS.items():
        (first, last, dead, found), said = killing(name, whole, stopped, kills)
        assert first == last == 0, said
        killed, saved = killed + dead, saved + found
        assert contents(stopped / name) == contents(whole / name)
        assert (stopped / f"{name}.json").read_bytes() == (whole / f"{name}.json").read_bytes()
        one, other = (json.loads((at / f"{name}_cost.json").read_text()) for at in (whole, stopped))
        assert [s["iteration"] for s in one["snapshots"]] == [
            s["iteration"] for s in other["snapshots"]
        ]
        assert not (stopped / f".{name}.unfinished").exists()
    assert killed == 50, "a child failed before all were killed"
    assert saved >= 10, "too few children had saved anything"


def limit_files():
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


def test_a_full_disk_ends_a_stage_and_leaves_what_was_there(prepare):
    folder = prepare()
    assert killing("warmup", folder, folder, 0)[0][0] == 0
    before = contents(folder / "warmup")
    # No file may grow beyond 20 kB, which no avatar fits into: as a full disk, to this process.
    status, said = killing("warmup", folder, folder, 0, preexec_fn=limit_files)
    assert status[0] == 1
    assert "ArtifactError: cannot write" in said
    assert contents(folder / "warmup") == before
