"""A small part of `make fuzz`, run once for all tests of this folder."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PART = ("--inputs", "4", "--every", "40")


@pytest.fixture(scope="session")
def sample(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What became of each reader's inputs, by its name.

    In a process of its own: with shapes checked on every call the readers would be far slower.
    """
    folder = tmp_path_factory.mktemp("fuzz")
    command = [sys.executable, "-m", "tests.fuzz", *PART, "--kept", str(folder)]
    done = subprocess.run(
        [*command, "--json", str(folder / "record.json")],
        cwd=ROOT,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (folder / "record.json").exists(), done.stderr
    record = json.loads((folder / "record.json").read_text())
    return {row["reader"]: row for row in record["rows"]}
