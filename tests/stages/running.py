"""A stage's script run as DVC runs it, in a process of its own or, quicker, in this one."""

import contextlib
import importlib.util
import json
import os
import runpy
import subprocess
import sys
import types
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from unittest import mock

from tests.process_state import ended_here

ROOT = Path(__file__).resolve().parents[2]
Start = Callable[..., "subprocess.CompletedProcess[str]"]
BEFORE = {"trajectory": "warmup", "fusion": "trajectory"}  # the stage that each goes on from


def words(options: Mapping[str, object]) -> list[str]:
    """A command line's words for the arguments of a script's `main`."""
    pairs = options.items()
    return [word for key, value in pairs for word in (f"--{key.replace('_', '-')}", str(value))]


def command(stage: str, options: Mapping[str, object]) -> list[str]:
    """A stage's command line, by the arguments of its `main`."""
    return [sys.executable, f"stages/{stage}.py", *words(options)]


@contextlib.contextmanager
def starting() -> Iterator[Start]:
    """Starts a script in a process of its own with the arguments of its `main`, and more words.

    One server for all of them (starting.py), because imports take seconds.
    """
    server = subprocess.Popen(
        [sys.executable, "tests/stages/starting.py"], cwd=ROOT, text=True, stdin=subprocess.PIPE,
        stdout=subprocess.PIPE, env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip

    def start(stage: str, *more: str, **options: object) -> "subprocess.CompletedProcess[str]":
        assert server.stdin is not None
        assert server.stdout is not None
        asked = [*command(stage, options), *more]
        server.stdin.write(f"{json.dumps(asked[1:])}\n")
        server.stdin.flush()
        return subprocess.CompletedProcess(asked, *json.loads(server.stdout.readline()))

    try:
        yield start
    finally:
        server.communicate()
    assert server.returncode == 0


def run_script(stage: str, **options: object) -> "subprocess.CompletedProcess[str]":
    """Run all lines of a stage's script here, with a command line as a process would have it.

    Tells what a process would have told: its exit code, and what it wrote.
    """
    asked = command(stage, options)
    with mock.patch.object(sys, "argv", asked[1:]):
        script = str(ROOT / asked[1])
        return ended_here(asked, lambda: runpy.run_path(script, run_name="__main__"))


def script_of(stage: str) -> types.ModuleType:
    """A stage's script as a module, to call its `main`."""
    spec = importlib.util.spec_from_file_location(f"{stage}_script", ROOT / f"stages/{stage}.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


def fitting_options(stage: str, folder: Path, read: Path) -> dict[str, Any]:
    """A fitting stage's arguments: it writes to `folder` and reads what others wrote to `read`."""
    given = {
        "avatar": "paper",
        "observations": read / "observations",
        "out": folder / stage,
        "metrics": folder / f"{stage}.json",
        "cost": folder / f"{stage}_cost.json",
        "params_file": folder / "params.yaml",
    }
    if stage in BEFORE:
        given |= {"method": "paper", BEFORE[stage]: read / BEFORE[stage]}
    return given
