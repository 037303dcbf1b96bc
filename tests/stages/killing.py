"""Runs fitting stages in child processes, one after the other, and kills each at some moment.

Called as a script, because a process that forks must not have started any threads: folder of
a run that is left alone, folder of one that is killed again and again, a seed, `stage=kills`. What
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

from deblur_avatar.training import resume as run_folder
from deblur_avatar.training import trainer as avatar_fit
from tests.stages.running import fitting_options, script_of


def child(
    script: types.ModuleType, stage: str, folder: Path, stop: int | None = None, wait_s: float = 0
) -> tuple[int, int]:
    """The exit status of one child that is killed `wait_s` after its `stop`-th call; its calls.

    A moment is a number of calls of Python functions, not a time: how far a child comes is the same
    on a busy machine. The wait lets it fall anywhere, into the middle of a write too.
    """
    heard, tell = os.pipe()
    pid = os.fork()
    if pid == 0:
        calls = 0

        def count(frame: types.FrameType, event: str, argument: object) -> None:
            nonlocal calls
            calls += event == "call"
            if calls == stop:
                sys.setprofile(None)
                os.write(tell, str(calls).encode())

        sys.setprofile(count)
        try:
            script.main(**fitting_options(stage, folder, folder))
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os.write(tell, str(calls).encode())
        os._exit(0)
    os.close(tell)
    said = os.read(heard, 64)  # nothing, if the child failed
    if stop is not None and said == str(stop).encode():
        time.sleep(wait_s)
        os.kill(pid, signal.SIGKILL)
    status = os.waitpid(pid, 0)[1]
    os.close(heard)
    return os.waitstatus_to_exitcode(status), int(said or 0)


def end(
    stage: str, whole: Path, stopped: Path, kills: int, draw: random.Random
) -> tuple[int, int, int, int]:
    """The exit status of both last runs of a stage, how many were killed, how many had saved."""
    script = script_of(stage)
    first, calls = child(script, stage, whole)
    killed, saved, status = 0, 0, first
    while killed < kills and status in (0, -signal.SIGKILL):
        stop, wait_s = 1 + draw.randrange(calls), 0.003 * draw.random()
        status, _ = child(script, stage, stopped, stop, wait_s)
        killed += status == -signal.SIGKILL
        saved += any(stopped.glob(f".{stage}.unfinished/after_*"))
    return first, child(script, stage, stopped)[0], killed, saved


def main(whole: Path, stopped: Path, seed: int, kills: dict[str, int]) -> None:
    """Print what became of each stage, a line each."""
    torch.set_num_threads(1)
    avatar_fit.NEIGHBOUR_REFRESH = 3
    run_folder.SAVE_EVERY_S = 0.0
    for stage, count in kills.items():
        found = end(stage, whole, stopped, count, random.Random(seed))
        sys.stdout.write(f"{' '.join(map(str, found))}\n")


if __name__ == "__main__":
    pairs = (word.split("=") for word in sys.argv[4:])
    main(
        Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]),
        {stage: int(count) for stage, count in pairs},
    )  # fmt: skip
