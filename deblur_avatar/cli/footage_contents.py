"""Footage contents: whether the files that a scene names are still those its clip was made of.

DVC follows parameters and what stages make. A user's own files lie anywhere and are named by their
path alone: another film under the same name, or better masks in the same folder, would change
nothing. So their digests are kept beside `dvc.lock`, in `footage.json`.

Where one of them is missing nothing may run: DVC removes a clip before it makes it again.
"""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from deblur_avatar.cli.homes import PARAMS, Home
from deblur_avatar.cli.running_dvc import reproduce
from deblur_avatar.config.reading import expand_environment, load_params
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.files import read_json, readable, write_json
from deblur_avatar.readers.file_contents import contents_digest

logger = logging.getLogger(__name__)

NAMED = ("path", "keypoints", "masks", "poses")  # of `clip`


@contextmanager
def followed_footage(home: Home, scene: str, body: str, found: Mapping[str, str]) -> Iterator[int]:
    """Make a scene's clip again, if its files are others than it was made of; remember them.

    Gives DVC's exit code. They are remembered however what goes on ends, if a clip was made. A clip
    that is not there may be in DVC's cache, made of other files: it is made again, too.

    Args:
        home: whose scene it is.
        scene: its name.
        body: that a pipeline far from a checkout makes first.
        found: of `contents_of`.
    """
    folder = home.folder
    record, made = folder / "footage.json", folder / "data/clip" / scene
    known, code = _known(record), 0
    if known != found and (known is not None or made.exists()):
        logger.info("The footage of %s may have changed since it was read: it is read again", scene)
        write_json(record, {})  # of one who is stopped from here on nothing is known
        steps = [["--force", "--single-item", f"clip@{scene}"]]
        code = reproduce(*[[f"body@{body}"]] * home.independent, *steps, folder=folder)
    try:
        yield code
    finally:
        if code == 0 and made.exists():
            write_json(record, found)


def contents_of(folder: Path, scene: str) -> dict[str, str]:
    """SHA-256 of each file and folder that a scene's `clip` names, by key.

    Paths are from the avatar's folder, in which stages run.

    Raises:
        ConfigError: if one is not there, or holds a variable that is not set.
        ArtifactError: if one of them cannot be read.
    """
    params = folder / PARAMS
    clip = load_params(params, f"scenes.{scene}.clip", dict)
    named = {key: clip[key] for key in NAMED if isinstance(clip.get(key), str)}
    paths = {key: folder / expand_environment(text, f"clip.{key}") for key, text in named.items()}
    for key, path in paths.items():
        if not _holds_something(path):
            raise ConfigError(
                f"{params}: scenes.{scene}.clip.{key}: nothing is at {path}; bring it back, or "
                "change the path. What was made stays as it is"
            )
    return {key: _digest(path) for key, path in paths.items()}


def _holds_something(path: Path) -> bool:
    """Whether there is a file, or a folder that is not empty, as that of an absent disk is."""
    with readable(path):
        return path.is_file() or (path.is_dir() and any(path.iterdir()))


def _digest(path: Path) -> str:
    with readable(path):
        return contents_digest(path)


def _known(record: Path) -> dict[str, str] | None:
    try:
        return read_json(record)
    except ArtifactError:
        return None
