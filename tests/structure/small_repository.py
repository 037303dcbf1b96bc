"""A repository of a few files with a pipeline, for tests of what DVC does in one."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

# What stages/code.py writes, without what a stage's process imports: torch takes two seconds.
CODE = """\
import json, sys
from pathlib import Path
from deblur_avatar.pipeline.code import fingerprints

root, out = Path(sys.argv[2]), Path(sys.argv[4])
out.write_text(json.dumps(fingerprints(root, out.parent), indent=1) + "\\n")
"""


def called(folder: Path, *command: str, code: Path | None = None) -> str:
    """What a command says there; `deblur_avatar` is that of the folder `code`, or of this one."""
    here = str(Path(sys.executable).parent)
    environment = os.environ | {
        "PATH": f"{here}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(code or folder),
        "DVC_NO_ANALYTICS": "1",
    }
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def ran(folder: Path, *options: str, code: Path | None = None) -> set[str]:
    """The stages that `dvc repro` runs, or with `--dry` would, apart from `code`."""
    lines = called(folder, "dvc", "repro", *options, code=code).splitlines()
    names = {line.split("'")[1] for line in lines if line.startswith("Running stage")}
    return {name for name in names if not name.endswith("code")}


def begin(root: Path, files: Mapping[str, str]) -> None:
    """Write the files, and make a repository of git's and DVC's there."""
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    called(root, "git", "init", "-q")
    called(root, "git", "config", "user.email", "a@b.c")
    called(root, "git", "config", "user.name", "a")
    called(root, "dvc", "init", "-q")


def commit(root: Path) -> None:
    """Commit all that git does not ignore."""
    called(root, "git", "add", "-A")
    called(root, "git", "commit", "-qm", "more")
