"""DVC as a subprocess: reproduce stages of a pipeline, take what they made, or send it."""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from deblur_avatar.cli.homes import missing_of_checkout
from deblur_avatar.cli.warm_stages import warmed
from deblur_avatar.errors import ConfigError
from deblur_avatar.pipeline.code import refresh
from deblur_avatar.sweep.commands import python_first


def check_checkout(folder: Path) -> None:
    """Refuse a folder that is no checkout of the repository.

    Raises:
        ConfigError: naming what is missing and where to start the command instead.
    """
    missing = missing_of_checkout(folder)
    if missing:
        raise ConfigError(
            f"no {', '.join(missing)} in {folder.resolve()}: this command runs the repository's "
            "pipeline; start it in a checkout of deblur-avatar"
        )


def reproduce(*steps: Sequence[str], folder: Path = Path(), refreshed: bool = False) -> int:
    """Run `dvc repro` with the words of each step, one after the other, in a folder.

    In a checkout fingerprints of code are refreshed first, as `make code` does; elsewhere the
    pipeline's own stage `code` does it.

    Args:
        steps: of words each.
        folder: where the pipeline is.
        refreshed: fingerprints are already; others may run beside, which DVC waits for.

    Returns:
        0, or the exit code of the first step that failed.
    """
    if not (refreshed or missing_of_checkout(folder)):
        refresh(folder)
    waiting = ["--wait-for-lock"] if refreshed else []
    for step in steps:
        code = _dvc([*waiting, "repro", *step], folder)
        if code != 0:
            return code
    return 0


def reproduce_from(remote: Path, stage: str, folder: Path) -> int:
    """Take a stage's outputs from a remote that no settings name, or make them.

    Returns:
        0, or another exit code if neither could be done.
    """
    return _with_remote("repro", remote, stage, folder)


def push(remote: Path, stage: str, folder: Path) -> int:
    """Send a stage's outputs, and what they were made from, to a remote that no settings name.

    Returns:
        0, or another exit code if that could not be done.
    """
    return _with_remote("push", remote, stage, folder)


def _with_remote(command: str, remote: Path, stage: str, folder: Path) -> int:
    words = ("deblur_avatar.cli.unlisted_remote", "--remote", str(remote), command, stage)
    return _python(words, folder)


def _dvc(words: Sequence[str], folder: Path) -> int:
    return _python(("dvc", *words), folder)


def _python(words: Sequence[str], folder: Path) -> int:
    return finish([sys.executable, "-m", *words], warmed(python_first(os.environ)), folder)


def finish(command: Sequence[str], environment: Mapping[str, str], folder: Path) -> int:
    """Run a command to its end; returns its exit code.

    A keyboard that interrupts reaches the command, too: it is waited for, so that DVC writes down
    what is done and gives its locks back.

    Raises:
        KeyboardInterrupt: once the command has ended.
    """
    with subprocess.Popen(command, env=environment, cwd=folder) as process:
        try:
            return process.wait()
        except KeyboardInterrupt:
            process.wait()
            raise
