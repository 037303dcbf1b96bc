"""A sample of `make fuzz`, and that no artifact is forgotten."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def sample() -> dict[str, dict]:
    """What became of each reader's inputs, by its name; in a process that shapes do not slow."""
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", "--inputs", "2", "--every", "80"],
        cwd=ROOT, env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode in (0, 1), done.stderr[-2000:]
    return {row["reader"]: row for row in map(json.loads, done.stdout.splitlines())}


def test_hostile_files_are_read_or_refused_with_an_error_of_our_own(sample):
    assert not {name: row["failures"] for name, row in sample.items() if row["failures"]}


def test_every_reader_reads_its_own_file_and_refuses_some_other(sample):
    assert len(sample) > 30
    for name, row in sample.items():
        assert row["read"], name
        assert row["refused"], name


def test_every_artifact_has_a_reader(sample):
    schemas = {
        statement.value.value
        for path in (ROOT / "deblur_avatar").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef) and [ast.unparse(b) for b in node.bases] == ["Artifact"]
        for statement in node.body
        if isinstance(statement, ast.AnnAssign) and ast.unparse(statement.target) == "schema"
    }
    assert len(schemas) > 5
    assert {f"artifact {schema}" for schema in schemas} <= set(sample)
