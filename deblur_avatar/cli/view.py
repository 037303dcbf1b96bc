"""Turn an avatar by hand in a browser, networks and all, also while it is fitted.

Pictures are drawn by the rasterizer on this machine and sent to a browser on it; nobody else can
reach them. Ends with Ctrl-C. For a file to send to someone: `deblur-avatar export --format page`.

All runs of the same scene that have an avatar can be chosen. One that is still fitted is shown as
the newest snapshot has it, with how far it is and how well each snapshot explains blurred frames
that were set aside; `deblur-avatar video` in another terminal is not disturbed, and goes first.
"""

import argparse
import logging
import os

from deblur_avatar.cli.export import find_run
from deblur_avatar.cli.shelf import SceneRuns
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.live_viewer import LiveViewer

logger = logging.getLogger(__name__)

LAST_PORT = 65535
NICENESS = 10  # of Linux's 19: a tenth of the processor that a fit would have for itself


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument("run", help="as for export: studio-lean, avatars/clip")
    parser.add_argument(
        "--motions", nargs="+", metavar="MOTION", default=["own", "builtin:jumping_jacks"],
        help="own, builtin:<name> or files (default: own builtin:jumping_jacks)",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=int, default=8080, help="on this machine, or the next free (default: 8080)"
    )


def run(asked: argparse.Namespace) -> int:
    """Serve until the keyboard interrupts; returns 0.

    Raises:
        ConfigError: if there is no such run, motion or port, or viser is not installed.
        ArtifactError: if the run has no avatar yet.
    """
    if not 0 <= asked.port <= LAST_PORT:  # the server would look for one for ever
        raise ConfigError(f"--port {asked.port}: wanted 0 (any that is free) to {LAST_PORT}")
    shelf = SceneRuns(*find_run(asked.run), asked.motions)
    first = shelf.news(shelf.names[0])
    assert first is not None  # nothing was asked for before
    if any(shelf.fitting(name) for name in shelf.names):
        os.nice(NICENESS)
    viewer = LiveViewer(first, shelf.motions(first), asked.port, shelf)
    logger.info("%s (Ctrl-C ends it)", viewer.address)
    viewer.run()
    return 0
