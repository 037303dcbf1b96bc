"""Write the video of a street scene, to go through `deblur-avatar video` as anybody's.

The body that the scene names must have been made: `dvc repro body@anny`.
"""

import argparse
import logging
from pathlib import Path

import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.cli.running_dvc import check_checkout
from deblur_avatar.config.reading import load_params
from deblur_avatar.errors import ConfigError
from deblur_avatar.imaging.video_writing import write_video
from deblur_avatar.parameters import SceneParams
from deblur_avatar.sources.studio.filming import build_set, film
from deblur_avatar.sources.studio.street import StreetParams

logger = logging.getLogger(__name__)

PARAMS, BODIES = Path("params.yaml"), Path("data/body")
SUFFIX = ".mp4"


def film_scene(scene: str, out: Path, params_file: Path, bodies: Path) -> int:
    """Film a scene as its parameters say; returns the number of frames.

    Raises:
        ConfigError: if there is no such scene, or it is no street, or writes no video.
        ArtifactError: if its body was not made, or the disk refuses.
    """
    params: SceneParams = load_params(params_file, f"scenes.{scene}", SceneParams)
    street = params.clip
    if not isinstance(street, StreetParams) or street.film.encoding is None:
        raise ConfigError(f"scenes.{scene} writes no video; one with clip.source: street does")
    body = Body.load(bodies / params.body)
    generator = torch.Generator().manual_seed(street.film.seed)
    take = film(build_set(street.film, body, generator), generator)
    frames = [frame.numpy() for frame in take.frames]
    return write_video(out, frames, street.film.fps, street.film.encoding.quality)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument("scene", help="of params.yaml, with clip.source: street")
    parser.add_argument("--out", type=Path, required=True, help="the video, ending in .mp4")


def run(asked: argparse.Namespace) -> int:
    """Film and say how much; returns 0.

    Raises:
        ConfigError: if this is no checkout, the file's name is no video's, or as `film_scene`.
        ArtifactError: as `film_scene`.
    """
    check_checkout(Path())
    if asked.out.suffix != SUFFIX:
        raise ConfigError(f"--out {asked.out}: a video's name ends in {SUFFIX}")
    count = film_scene(asked.scene, asked.out, PARAMS, BODIES)
    logger.info("%s: %d frames of scene %s", asked.out, count, asked.scene)
    return 0
