"""Footage folders: a source's root folder, and the files below it that others name."""

import re
from pathlib import Path

from deblur_avatar.config.reading import expand_environment
from deblur_avatar.errors import ArtifactError, ConfigError


def footage_folder(root: str, remedy: str) -> Path:
    """Find a source's root folder.

    Args:
        root: of the parameters; may hold `$(VARIABLE:-default)`.
        remedy: what belongs there and where it is to be had.

    Raises:
        ConfigError: if there is no such folder, or its variable is not set; says what to set.
    """
    variable = re.search(r"\$[{(](\w+)", root)
    setting = f"set {variable[1]}" if variable else "set clip.root in params.yaml"
    try:
        folder = Path(expand_environment(root, "clip.root"))
    except ConfigError as error:
        raise ConfigError(f"{error}; it says where {remedy}") from None
    if not folder.is_dir():
        raise ConfigError(f"clip.root: no folder {folder}; {setting} to where {remedy}")
    return folder


def file_inside(folder: Path, name: str) -> Path:
    """The path of a file that an untrusted list names; it need not exist.

    Raises:
        ArtifactError: if it leaves the folder, by its name or through a symbolic link.
    """
    path = folder / name
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links; a name with a zero byte
        raise ArtifactError(f"{folder} can hold no file {name!r:.200}: {error}") from None
    if not inside:
        raise ArtifactError(
            f"{name!r} leads out of {folder}; nothing outside of it is read, copy the files there"
        )
    return path
