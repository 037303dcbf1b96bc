"""Footage contents: whether the files that a scene names are still those its clip was made of.

DVC follows parameters and what stages make. A user's own files lie anywhere and are named by their
path alone: another film under the same name, or better masks in the same folder, would change
nothing. So their digests are kept beside `dvc.lock`, in `footage.json`.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deblur_avatar.cli.homes import PARAMS, Home
from deblur_avatar.cli.running_dvc import reproduce
from deblur_avatar.config.reading import expand_environment, load_params
from deblur_avatar.errors import ArtifactError
from deblur_avatar.readers.file_contents import contents_digest
from deblur_avatar.run import read_json, write_json

logger = logging.getLogger(__name__)

NAMED = ("path", "keypoints", "masks", "poses")  # of `clip`


@contextmanager
def followed_footage(home: Home, scene: str, body: str) -> Iterator[int]:
    """Make a scene's clip again, if its files are others than it was made of; remember them.

    Gives DVC's exit code. They are remembered however what goes on ends, if a clip was made. A clip
    that is not there may be in DVC's cache, made of other files: it is made again, too.
    """
    folder = home.folder
    found = contents_of(folder, scene)
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
    """SHA-256 of each file and folder that a scene's `clip` names and that is there, by key.

    Paths are from the avatar's folder, in which stages run.

    Raises:
        ConfigError: if one holds a variable that is not set.
        ArtifactError: if one of them cannot be read.
    """
    clip = load_params(folder / PARAMS, f"scenes.{scene}.clip", dict)
    named = {key: clip[key] for key in NAMED if isinstance(clip.get(key), str)}
    paths = {key: folder / expand_environment(text, f"clip.{key}") for key, text in named.items()}
    return {key: _digest(path) for key, path in paths.items() if path.exists()}


def _known(record: Path) -> dict[str, str] | None:
    try:
        return read_json(record)
    except ArtifactError:
        return None


def _digest(path: Path) -> str:
    try:
        return contents_digest(path)
    except OSError as error:
        raise ArtifactError(f"{path} cannot be read: {error.strerror}") from error
