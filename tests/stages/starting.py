"""Starts scripts of stages, each in a process of its own that holds nothing of the package yet.

What others wrote and takes seconds to import is imported here, once; a script's process is a fork
of this one, which must not have started any threads and is a script itself for that reason. Reads
command lines, a line of JSON each; answers each with exit code, standard output, standard error.
"""

import json
import os
import runpy
import sys
import tempfile
import traceback

import av  # noqa: F401
import cv2  # noqa: F401
import matplotlib.pyplot as plt  # noqa: F401
import scipy.spatial  # noqa: F401
import torch  # noqa: F401
import torch._dynamo  # noqa: F401, the optimisers' first step would import it


def ran(words: list[str]) -> tuple[int, str, str]:
    """What comes of a child that runs a script with the words of a command line."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as said:
        pid = os.fork()
        if pid == 0:
            os.dup2(out.fileno(), sys.stdout.fileno())
            os.dup2(said.fileno(), sys.stderr.fileno())
            os._exit(end_of(words))
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        for file in (out, said):
            file.seek(0)
        return code, out.read(), said.read()


def end_of(words: list[str]) -> int:
    """Run a script in this process to its end; returns the exit code."""
    sys.argv, code = words, 0
    try:
        runpy.run_path(words[0], run_name="__main__")
    except SystemExit as end:
        code = int(end.code or 0)
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    return code


def main() -> None:
    assert not [name for name in sys.modules if name.partition(".")[0] == "deblur_avatar"]
    for line in sys.stdin:
        sys.stdout.write(f"{json.dumps(ran(json.loads(line)))}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
