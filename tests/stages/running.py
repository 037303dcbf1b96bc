"""A stage's script run as DVC runs it, in a process of its own, or loaded into this one."""

import importlib.util
import subprocess
import sys
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
BEFORE = {"trajectory": "warmup", "fusion": "trajectory"}  # the stage that each goes on from


def words(options: Mapping[str, object]) -> list[str]:
    """A command line's words for the arguments of a script's `main`."""
    pairs = options.items()
    return [word for key, value in pairs for word in (f"--{key.replace('_', '-')}", str(value))]


def run_script(stage: str, **options: object) -> "subprocess.CompletedProcess[str]":
    """Run a stage with the arguments of its `main`, whatever comes of it."""
    return subprocess.run(
        [sys.executable, f"stages/{stage}.py", *words(options)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip


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
