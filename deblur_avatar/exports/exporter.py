"""Exporter protocol: what every kind of file does that a fitted run is written as.

An exporter is its options with one method. A new one is a module with such a class and a line in
`exports/registry.py` (docs/extending.md).
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Protocol, runtime_checkable

from deblur_avatar.animation.stage import Stage, stage_of_clip
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.errors import ConfigError


@dataclass(frozen=True)
class FittedRun:
    """What a run leaves behind: who was fitted, how it moved, how it was filmed.

    `sharp` are the filming camera's sharp frames where the source knows them: only to be shown, no
    number comes from them. `beside` is another run that formats show next to this one where they
    can show two.
    """

    name: str
    avatar: Avatar
    motion: Motion
    observations: Observations
    sharp: Observations | None = None
    beside: "FittedRun | None" = None

    @cached_property
    def stage(self) -> Stage:
        """Where the person was filmed, found once for all that is written.

        Raises:
            ConfigError: if the camera looked along her vertical.
        """
        try:
            return stage_of_clip(self.observations, self.avatar.betas)
        except ValueError as error:
            raise ConfigError(f"export: {error}") from None


def sharp_observations(folder: Path) -> Observations | None:
    """The sharp frames that `preprocess` wrote; None where the source knows none.

    Raises:
        ArtifactError: if they are damaged.
    """
    known = folder.is_dir() and any(folder.iterdir())
    return Observations.load(folder) if known else None


@runtime_checkable
class Exporter(Protocol):
    """One format, with its options."""

    suffix: ClassVar[str]  # of the file's name, with the dot

    def export(self, run: FittedRun, path: Path) -> None:
        """Write the file in one move: whole or not at all.

        Raises:
            ConfigError: if the options do not fit the run.
            ArtifactError: if the disk refuses.
        """
        ...
