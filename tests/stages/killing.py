"""Runs a fitting stage in child processes, one after the other, and kills each at some moment.

Called as a script, because a process that forks must not have started any threads: stage, folder of
a run that is left alone, folder of one that is killed again and again, how many kills, a seed. What
is slow to import is imported before the first child.
"""

import os
import random
import signal
import sys
import time
import traceback
import types
from pathlib import Path

import torch
import torch._dynamo  # the optimisers' first step would import it

from deblur_avatar.fitting import avatar_fit, run_folder
from tests.stages.running import fitting_options, script_of


def child(script: types.ModuleType, stage: str, folder: Path, limit_s: float | None) -> int:
    """The exit status of one child, which is killed after `limit_s`."""
    end = time.monotonic() + (float("inf") if limit_s is None else limit_s)
    pid = os.fork()
    if pid == 0:
        try:
            script.main(**fitting_options(stage, folder, folder))
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    while True:
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > end:
            os.kill(pid, signal.SIGKILL)
            return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        time.sleep(0.002)


def main(stage: str, whole: Path, stopped: Path, kills: int, seed: int) -> None:
    """Print the exit status of both last runs, how many were killed, how many had saved."""
    torch.set_num_threads(1)
    avatar_fit.NEIGHBOUR_REFRESH = 3
    run_folder.SAVE_EVERY_S = 0.0
    script, draw = script_of(stage), random.Random(seed)
    begin = time.monotonic()
    first = child(script, stage, whole, None)
    pace = time.monotonic() - begin
    killed, saved = 0, 0
    for _ in range(kills):
        killed += child(script, stage, stopped, 0.6 * pace * draw.random()) == -signal.SIGKILL
        saved += any(stopped.glob(f".{stage}.unfinished/after_*"))
    last = child(script, stage, stopped, None) if kills else first
    sys.stdout.write(f"{first} {last} {killed} {saved}\n")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4]), int(sys.argv[5]))
