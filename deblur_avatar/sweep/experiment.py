"""One experiment: `dvc exp run` in a clone that shares the cache, sent back to the repository."""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

DVC = (sys.executable, "-m", "dvc")


def run(root: Path, target: str, name: str, values: Sequence[str]) -> int:
    """Run it; returns 0, or the exit code of the first command that failed.

    Args:
        root: the repository that has the target and gets the experiment.
        target: a pipeline, or a stage of one.
        name: of the experiment.
        values: `key=value` each.
    """
    cache = _output([*DVC, "cache", "dir"], root)
    with tempfile.TemporaryDirectory(prefix=f"{name[:40]}-") as folder:
        clone = Path(folder, "clone")
        # The clone's own code runs, whatever is being changed where the package is installed.
        environment = os.environ | {"PYTHONPATH": str(clone)}
        settings = [word for value in values for word in ("-S", value)]
        for command, place in (
            (["git", "clone", "--quiet", "--shared", str(root), str(clone)], root),
            ([*DVC, "cache", "dir", "--local", cache], clone),
            ([*DVC, "exp", "run", "--name", name, *settings, target], clone),
            ([*DVC, "exp", "push", "--no-cache", "--force", "origin", name], clone),
        ):
            code = _ended(command, place, environment)
            if code:
                return code
    return 0


def _ended(command: Sequence[str], folder: Path, environment: Mapping[str, str]) -> int:
    return subprocess.run(command, cwd=folder, env=environment, check=False).returncode


def _output(command: Sequence[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True)
    return str((folder / done.stdout.strip()).resolve())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", type=Path, required=True)
    parser.add_argument("--target", required=True)
    parser.add_argument("--name", required=True)
    parser.add_argument("--set", action="append", default=[], dest="values")
    asked = parser.parse_args()
    sys.exit(run(asked.root, asked.target, asked.name, asked.values))
