"""Unlisted remote: DVC with a remote that no file of settings names.

DVC's command line knows remotes by its files of settings alone, and `dvc repro --pull` takes from
the default one alone, to which a user's `dvc push` would then send everything.
"""

import argparse
import logging
import sys

from dvc.exceptions import DvcException
from dvc.repo import Repo

from deblur_avatar.ending import STOPPED

logger = logging.getLogger("dvc")  # DVC's own, which says an exception in a line

NAME = "deblur_avatar.unlisted"  # nobody else's: DVC adds to what settings say of a name


def run(command: str, remote: str, stage: str) -> int:
    """Take a stage's outputs from a remote, or make them; or send them there.

    Args:
        command: `repro` or `push`, with what DVC remembers of runs.
        remote: its address.
        stage: of the pipeline in this folder.

    Returns:
        0, 1 where DVC says why it did not, or the code of Ctrl-C, which who started this answers.
    """
    try:
        with Repo(remote=NAME, remote_config={"url": remote}) as repo:
            if command == "repro":
                repo.reproduce(stage, pull=True)
            else:
                repo.push(stage, run_cache=True)
    except (DvcException, OSError):
        logger.exception("")
        return 1
    except KeyboardInterrupt:
        return STOPPED
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--remote", required=True)
    parser.add_argument("command", choices=("repro", "push"))
    parser.add_argument("stage")
    asked = parser.parse_args()
    sys.exit(run(asked.command, asked.remote, asked.stage))
