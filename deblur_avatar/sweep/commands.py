"""Task commands: `dvc repro` of one stage, and the guard that leaves no orphan behind."""

import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from deblur_avatar.sweep.scheduler import End
from deblur_avatar.sweep.tasks import Task

LAST_BYTES = 4000  # of what a task wrote
# What DVC says where another command holds what a stage needs, and how a stage's process ended.
HELD = re.compile(r"is busy|Unable to acquire lock")
EXITED = re.compile(r"exited with (-?\d+)")
KILLED = range(129, 193)  # a shell's codes for a process that a signal killed: 128 and its number
REPRO = (sys.executable, "-m", "dvc", "--wait-for-lock", "repro", "--single-item")


def guarded(task: Task) -> list[str]:
    """The task's command below its guard."""
    return [sys.executable, "-m", "deblur_avatar.sweep.guard", *task.command]


def environment_of(task: Task, given: Mapping[str, str]) -> dict[str, str]:
    """Variables of a task's process: its threads, and this environment's `python` first."""
    cores = str(task.cores)
    return python_first(given) | {"OMP_NUM_THREADS": cores, "DEBLUR_AVATAR_THREADS": cores}


def python_first(given: Mapping[str, str]) -> dict[str, str]:
    """Variables by which `python` is this environment's, whatever the shell's path says.

    Stages' commands say `python`.
    """
    here = str(Path(sys.executable).parent)
    return {**given, "PATH": f"{here}{os.pathsep}{given.get('PATH', '')}"}


def end_of(code: int, said: str) -> End:
    """What an exit code and last words mean."""
    if code == 0:
        return "done"
    codes = [code, *map(int, EXITED.findall(said))]
    killed = any(one < 0 or one in KILLED for one in codes)
    return "lost" if killed or HELD.search(said) else "failed"


def last_words(log: IO[bytes]) -> str:
    """The last of what a task wrote."""
    log.seek(0, os.SEEK_END)
    log.seek(max(0, log.tell() - LAST_BYTES))
    return log.read().decode(errors="replace").strip()
