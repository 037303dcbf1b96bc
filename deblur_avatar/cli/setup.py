"""Install what pip cannot: two packages whose own lists of dependencies would break this one.

mediapipe finds people and their mattes. It asks for numpy below 2 and a second OpenCV, which would
replace the ones in use, and for jax, which nothing here calls.
anny is the body. It asks for warp-lang, 150 MB that nothing here calls.

Both are installed with `pip install --no-deps`, in the versions that were tested; what they do need
is among the dependencies of deblur-avatar itself. Nothing else is changed. Once an environment.
"""

import argparse
import importlib.util
import logging
import shlex
import subprocess
import sys

from deblur_avatar.errors import ConfigError
from deblur_avatar.rendering.native_build import BuildError, find_compiler

logger = logging.getLogger(__name__)

ALONE = {"mediapipe": "mediapipe==0.10.21", "anny": "anny==0.6.2"}  # by the name to import
PROOF = "import anny; from mediapipe.python.solutions.pose import Pose"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument("--dry-run", action="store_true", help="say what would be run, and end")


def run(asked: argparse.Namespace) -> int:
    """Install and prove it; returns 0.

    Raises:
        ConfigError: if this environment has no pip, or pip fails, or what it brought does not work.
    """
    command = [sys.executable, "-m", "pip", "install", "--no-deps", *ALONE.values()]
    logger.info("%s", shlex.join(command))
    if asked.dry_run:
        return 0
    if importlib.util.find_spec("pip") is None:
        raise ConfigError(
            f"no pip in {sys.prefix}; let the installer that made this environment install "
            f"{' and '.join(ALONE.values())}, without their dependencies"
        )
    if subprocess.run(command, check=False).returncode != 0:
        raise ConfigError("pip failed; what it said stands above")
    _prove()
    try:
        find_compiler()
    except BuildError as error:
        logger.warning("%s. Without one everything runs, but slowly.", error)
    logger.info("All is installed: deblur-avatar video clip.mp4")
    return 0


def _prove() -> None:
    """Import both in a fresh process, as stages do."""
    done = subprocess.run(
        [sys.executable, "-c", PROOF], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise ConfigError(f"installed, but not to be imported: {done.stderr.strip()[-400:]}")
