"""Export: a fitted run as files that other programs open."""

from pathlib import Path

from deblur_avatar.config.section import Params
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun
from deblur_avatar.exports.registry import ExportParams


class ExportsParams(Params):
    """What is written of the run of this name: files by their names, each of a format."""

    scene: str
    files: dict[str, ExportParams]


def export(run: FittedRun, params: ExportsParams, out: Path, where: str) -> None:
    """Write all files of a run into a folder.

    Args:
        run: that was fitted.
        params: which files.
        out: the folder.
        where: key of `params`, for messages.

    Raises:
        ConfigError: if a file's name is not of its format, or the run cannot be written so.
        ArtifactError: if the disk refuses.
    """
    for name, exporter in params.files.items():
        if Path(name).name != name or Path(name).suffix != exporter.suffix:
            raise ConfigError(
                f"{where}.files: {name!r} must be a name that ends in {exporter.suffix!r}"
            )
    for name, exporter in params.files.items():
        exporter.export(run, out / name)
