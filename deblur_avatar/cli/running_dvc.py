"""DVC as a subprocess: reproduce stages of the repository's pipeline."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from deblur_avatar.errors import ConfigError
from deblur_avatar.pipeline.code import refresh

CHECKOUT = ("dvc.yaml", "params.yaml", "stages")  # what a checkout of the repository has


def check_checkout(folder: Path) -> None:
    """Refuse a folder that is no checkout of the repository.

    Raises:
        ConfigError: naming what is missing and where to start the command instead.
    """
    missing = [name for name in CHECKOUT if not (folder / name).exists()]
    if missing:
        raise ConfigError(
            f"no {', '.join(missing)} in {folder.resolve()}: this command runs the repository's "
            "pipeline; start it in a checkout of deblur-avatar"
        )


def reproduce(*steps: Sequence[str], refreshed: bool = False) -> int:
    """Run `dvc repro` with the words of each step, one after the other, in this folder.

    Fingerprints of code are refreshed first, as `make code` does.

    Args:
        steps: of words each.
        refreshed: they are already; others may run beside, which DVC waits for.

    Returns:
        0, or the exit code of the first step that failed.
    """
    if not refreshed:
        refresh(Path())
    # Stage commands say `python`: the environment's own, whatever the shell's path says.
    here = str(Path(sys.executable).parent)
    environment = os.environ | {"PATH": f"{here}{os.pathsep}{os.environ.get('PATH', '')}"}
    for step in steps:
        waiting = ["--wait-for-lock"] if refreshed else []
        command = [sys.executable, "-m", "dvc", *waiting, "repro", *step]
        code = subprocess.run(command, env=environment, check=False).returncode
        if code != 0:
            return code
    return 0
