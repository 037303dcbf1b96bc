"""What fingerprints in place of files ask of DVC, tried on a pipeline of two small stages.

One repository with the pipeline at its root and a copy of it in an experiment's folder.
"""

import os
import shutil
from functools import partial
from pathlib import Path

import pytest

from tests.structure import small_repository
from tests.structure.small_repository import CODE, begin, commit

ROOT = Path(__file__).parents[2]
PIPELINE = """\
stages:
  code:
    cmd: python ${from.root}/stages/code.py --root ${from.root} --out code.json
    always_changed: true
    outs:
      - code.json: {cache: false}
  cut:
    foreach: ${runs}
    do:
      cmd: python ${from.root}/stages/cut.py data/${key} ${item.size}
      params:
        - code.json: [cut]
        - ${from.methods}: ["methods.${item.method}"]
        - params.yaml: [seed]
      outs: ["data/${key}"]
"""
PARAMS = """\
from: {root: ., methods: params.yaml}
seed: 0
methods: {long: 9, short: 1}
runs: {one: {size: 1, method: long}, two: {size: 2, method: short}}
"""
OWN = """\
from: {root: ../.., methods: ../../params.yaml}
seed: 1
runs: {three: {size: 3, method: long}}
"""
CUT = """\
import sys
from pathlib import Path

Path(sys.argv[1]).parent.mkdir(exist_ok=True)
Path(sys.argv[1]).write_text(sys.argv[2])
"""
ALL = {"cut@one", "cut@two", "experiments/a/dvc.yaml:cut@three"}


# By this repository's code.
called = partial(small_repository.called, code=ROOT)
ran = partial(small_repository.ran, code=ROOT)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The repository, run once and committed."""
    root = tmp_path_factory.mktemp("made")
    files = {
        "dvc.yaml": PIPELINE, "experiments/a/dvc.yaml": PIPELINE, "params.yaml": PARAMS,
        "experiments/a/params.yaml": OWN, ".gitignore": "code.json\ndata/\n",
        "stages/cut.py": CUT,
        "stages/code.py": CODE,
    }  # fmt: skip
    begin(root, files)
    assert ran(root, "-P") == ALL
    commit(root)
    return root


@pytest.fixture
def repository(made, tmp_path):
    return Path(shutil.copytree(made, tmp_path / "copy", symlinks=True))


def test_nothing_runs_twice_and_a_comment_runs_nothing(repository):
    assert ran(repository, "-P", "--dry") == set()
    cut = repository / "stages/cut.py"
    cut.write_text(f"# why\n{CUT}")
    assert ran(repository, "-P") == set()


def test_changed_code_runs_what_depends_on_it_even_where_one_stage_is_asked_for(repository):
    cut = repository / "stages/cut.py"
    cut.write_text(CUT.replace("sys.argv[2])", "sys.argv[2] * 2)"))
    assert ran(repository, "-P", "--dry") == set()  # DVC has to be told: `make code`
    assert ran(repository, "cut@one") == {"cut@one"}
    assert ran(repository, "-P", "--dry") == ALL - {"cut@one", "experiments/a/dvc.yaml:cut@three"}
    assert ran(repository, "experiments/a/dvc.yaml") == {"experiments/a/dvc.yaml:cut@three"}


def test_a_parameter_that_folders_share_runs_both(repository):
    path = repository / "params.yaml"
    path.write_text(PARAMS.replace("long: 9", "long: 8"))
    assert ran(repository, "-P", "--dry") == ALL - {"cut@two"}


def test_a_fresh_clone_is_up_to_date_without_data(repository, tmp_path):
    called(tmp_path, "git", "clone", "-q", str(repository), "clone")
    for folder in (".", "experiments/a"):
        root = os.path.relpath(".", folder)
        command = ["python", f"{root}/stages/code.py", "--root", root, "--out", "code.json"]
        called(tmp_path / "clone" / folder, *command)
    assert ran(tmp_path / "clone", "-P", "--dry", "--allow-missing") == set()


def test_experiments_set_parameters_of_either_folder(repository):
    command = ["dvc", "exp", "run", "experiments/a/dvc.yaml", "-n", "more"]
    called(repository, *command, "-S", "experiments/a/params.yaml:seed=5")
    shown = called(repository, "dvc", "exp", "show", "--csv")
    header, *rows = (line.split(",") for line in shown.splitlines())
    seeds = {row[0]: row[header.index("experiments/a/params.yaml:seed")] for row in rows}
    assert seeds["more"] == "5"
