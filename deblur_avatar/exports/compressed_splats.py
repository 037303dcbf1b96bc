"""Compressed splats: Niantic's SPZ and PlayCanvas's SOG, both lossy, made from the PLY of a pose.

The only module that knows gaussforge, which writes both (extra `spz`).
"""

from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from deblur_avatar.config.section import Params
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.ply import frame_as_ply
from deblur_avatar.files import write_bytes


class SpzExport(Params):
    """One frame's pose in about a quarter of the PLY's bytes."""

    suffix: ClassVar[str] = ".spz"

    format: Literal["spz"]
    frame: Annotated[int, Field(ge=0)]  # position in the clip

    def export(self, run: FittedRun, path: Path) -> None:
        """Write the avatar at the middle of this frame's exposure."""
        write_bytes(path, _converted(frame_as_ply(run, self.frame), "spz"))


class SogExport(Params):
    """One frame's pose as pictures in an archive, in about a fifth of the PLY's bytes."""

    suffix: ClassVar[str] = ".sog"

    format: Literal["sog"]
    frame: Annotated[int, Field(ge=0)]  # position in the clip

    def export(self, run: FittedRun, path: Path) -> None:
        """Write the avatar at the middle of this frame's exposure."""
        write_bytes(path, _converted(frame_as_ply(run, self.frame), "sog"))


def _converted(ply: bytes, to: str) -> bytes:
    try:
        import gaussforge
    except ImportError:
        raise ConfigError(
            f"export: {to} needs gaussforge; pip install 'deblur-avatar[spz]'"
        ) from None
    done = gaussforge.GaussForge().convert(ply, "ply", to)
    if "data" not in done:
        raise ConfigError(f"export: {to}: {done.get('error', 'gaussforge wrote nothing')}")
    return bytes(done["data"])
