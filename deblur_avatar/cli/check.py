"""Say whether scenes are fit for training.

Writes data/check/<scene>/index.html: how blurred the clip is, how well body and masks fit, and what
to change where they do not.
"""

import argparse
import logging
from pathlib import Path

from deblur_avatar.cli.running_dvc import check_checkout, reproduce
from deblur_avatar.config.reading import load_params
from deblur_avatar.errors import ConfigError

logger = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument("scene", nargs="*", help="of params.yaml; all of them if none is named")


def run(asked: argparse.Namespace) -> int:
    """Run the stage `check` of the scenes asked for; returns DVC's exit code."""
    check_checkout(Path())
    known = list(load_params(Path("params.yaml"), "scenes", dict))
    for scene in asked.scene:
        if scene not in known:
            raise ConfigError(f"no scene {scene!r} in params.yaml, there is {', '.join(known)}")
    code = reproduce([f"check@{scene}" for scene in asked.scene] or ["check"])
    if code == 0:
        for scene in asked.scene or known:
            logger.info("data/check/%s/index.html", scene)
    return code
