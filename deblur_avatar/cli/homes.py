"""Homes: the folder that an avatar is made in, and where the pipeline's files are from there.

In a checkout of the repository an avatar lives in `avatars/<name>/` and takes pipeline, settings
and body from the root. Anywhere else it lives in `<name>/`, which then has all of that itself:
copies of the pipeline's files in `pipeline/`, a body, and a DVC repository of its own.
"""

import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from configobj import ConfigObj, ConfigObjError

import deblur_avatar
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.files import readable, write_bytes, write_text
from deblur_avatar.pipeline.code import PIPELINE

PARAMS, SCRIPTS, SHIPPED = "params.yaml", "stages", "pipeline_files"
CHECKOUT = (PIPELINE, PARAMS, SCRIPTS)  # what a checkout of the repository has
AVATARS, OWN_ROOT = "avatars", "pipeline"
DVC_CONFIG = "[core]\n    no_scm = True\n    analytics = false\n    check_update = false\n"
# Earlier versions made the cache of all folders' bodies the default remote: a user's `dvc push`
# sent everything there. No other section of DVC's settings has this key.
FORMER_DEFAULT = "bodies"
ITS_LINE = rb"""(?m)^[ \t]*remote[ \t]*=[ \t]*(['"]?)bodies\1[ \t]*(?:#.*)?(?:\n|\Z)"""


@dataclass(frozen=True)
class Home:
    """Where one avatar is made."""

    folder: Path
    root: Path  # dvc.yaml, params.yaml and stages/, as the avatar's pipeline finds them
    source: Path  # where these are read from

    @property
    def independent(self) -> bool:
        """Whether the folder needs no checkout."""
        return self.root != self.source

    @property
    def up(self) -> str:
        """The way from the folder to the root."""
        return os.path.relpath(self.root, self.folder)

    def install(self) -> None:
        """Write what the folder needs besides its parameters: copies that follow the package.

        DVC's settings are the user's to change, once written.

        Raises:
            ConfigError: if DVC's settings of this machine cannot be read.
            ArtifactError: if the disk refuses.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            shutil.copy(self.source / PIPELINE, self.folder / PIPELINE)
            if self.independent:
                scripts = self.root / SCRIPTS
                shutil.rmtree(scripts, ignore_errors=True)
                ignored = shutil.ignore_patterns("__pycache__")
                shutil.copytree(self.source / SCRIPTS, scripts, ignore=ignored)
                shutil.copy(self.source / PARAMS, self.root / PARAMS)
                config = self.folder / ".dvc/config"
                if not config.exists():  # its user may have added a remote to it
                    write_text(config, DVC_CONFIG)
                _take_back_default(config.with_name("config.local"))
        except OSError as error:
            raise ArtifactError(f"cannot write {self.folder}: {error}") from error


def _take_back_default(settings: Path) -> None:
    try:
        content = settings.read_bytes()
        core = ConfigObj(content.decode().splitlines()).get("core")
        default = core.get("remote") if isinstance(core, dict) else None
    except FileNotFoundError:
        return
    except (OSError, UnicodeDecodeError, ConfigObjError) as error:
        raise ConfigError(
            f"{settings} holds no settings that DVC can read: {error}; mend it, or remove it"
        ) from error
    if default == FORMER_DEFAULT:
        write_bytes(settings, re.sub(ITS_LINE, b"", content))


def home_of(name: str, here: Path) -> Home:
    """Where an avatar of this name is made by a command that was started in `here`.

    Raises:
        ConfigError: if something else lies there.
        ArtifactError: if what lies there may not be looked into.
    """
    checkout = not missing_of_checkout(here)
    folder = here / AVATARS / name if checkout else here / name
    with readable(folder):
        taken = folder.exists() and not (folder / PARAMS).is_file()
    if checkout:
        return Home(folder, here, here)
    if taken:
        raise ConfigError(
            f"{folder} is there and holds no avatar, which would be made in it; choose another "
            f"name: --name {name}_avatar"
        )
    return Home(folder, folder / OWN_ROOT, pipeline_files())


def missing_of_checkout(folder: Path) -> list[str]:
    """What a folder lacks to be a checkout of the repository."""
    return [name for name in CHECKOUT if not (folder / name).exists()]


def pipeline_files() -> Path:
    """The folder of dvc.yaml, params.yaml and stages/ that belong to this package.

    A wheel has them within the package; otherwise the package is a checkout's.
    """
    package = Path(deblur_avatar.__file__).parent
    return package / SHIPPED if (package / SHIPPED).is_dir() else package.parent
