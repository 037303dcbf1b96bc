"""Turn a fitted avatar by hand in a browser, networks and all.

Pictures are drawn by the rasterizer on this machine and sent to a browser on it; nobody else can
reach them. Ends with Ctrl-C. For a file to send to someone: `deblur-avatar export --format page`.
"""

import argparse
import logging

from deblur_avatar.cli.export import find_run, load_run
from deblur_avatar.exports.live_viewer import LiveViewer
from deblur_avatar.exports.shown_motion import shown_motions

logger = logging.getLogger(__name__)

SECONDS, FPS = 10.0, 30.0  # of motions that were not filmed


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument("run", help="as for export: studio-lean, avatars/clip")
    parser.add_argument(
        "--motions", nargs="+", metavar="MOTION", default=["own", "builtin:jumping_jacks"],
        help="own, builtin:<name> or files (default: own builtin:jumping_jacks)",
    )  # fmt: skip
    parser.add_argument("--port", type=int, default=8080, help="on this machine (default: 8080)")


def run(asked: argparse.Namespace) -> int:
    """Serve until the keyboard interrupts; returns 0.

    Raises:
        ConfigError: if there is no such run or motion, or viser is not installed.
        ArtifactError: if the run was not made yet.
    """
    fitted = load_run(*find_run(asked.run))
    viewer = LiveViewer(fitted, shown_motions(fitted, asked.motions, FPS, SECONDS), asked.port)
    logger.info("%s (Ctrl-C ends it)", viewer.address)
    viewer.run()
    return 0
