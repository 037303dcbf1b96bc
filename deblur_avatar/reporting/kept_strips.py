"""Strips that stay in the repository: what one avatar made of a scene, beside input and truth.

Conventions. A folder holds one avatar on one scene: `strips.json` and, for each view, a JPEG a
label. With each motion lies the quality of the fit that the pictures are of, so that pictures of
another fit than the tables' are known for what they are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, StringConstraints, ValidationError

from deblur_avatar.errors import ArtifactError
from deblur_avatar.files import read_json, write_bytes, write_json
from deblur_avatar.imaging.picture_files import jpeg_bytes
from deblur_avatar.reporting.picture_strips import INPUT, TRUTH, Strip

INDEX = "strips.json"


class _Index(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True)

    captions: list[str]
    fits: dict[Annotated[str, StringConstraints(pattern=r"^\w+$")], float | None]
    truth: bool


@dataclass(frozen=True)
class KeptStrips:
    """The pictures of one avatar on one scene."""

    folder: Path
    captions: tuple[str, ...]  # of each view
    fits: dict[str, float | None]  # PSNR of the seen surface in dB, by motion; None: of no pixel
    truth: bool  # whether there is a picture of it

    def picture(self, view: int, label: str) -> Path:
        """Where a picture lies: of a motion, the input or the truth."""
        return _picture(self.folder, view, label)


def keep_strips(folder: Path, strips: Sequence[Strip], fits: Mapping[str, float | None]) -> None:
    """Write strips in place of those that the folder holds.

    Args:
        folder: of this avatar on this scene.
        strips: labelled by `INPUT`, motions and `TRUTH`.
        fits: quality of each motion's fit.

    Raises:
        ArtifactError: if the disk refuses.
    """
    try:
        # The list goes first and comes last: pictures without one are no strips.
        for path in (folder / INDEX, *folder.glob("*.jpg")):
            path.unlink(missing_ok=True)
    except OSError as error:
        raise ArtifactError(f"cannot write {folder}: {error}") from error
    for view, strip in enumerate(strips):
        for label, picture in strip.pictures.items():
            write_bytes(_picture(folder, view, label), jpeg_bytes(picture))
    captions = [strip.caption for strip in strips]
    truth = any(TRUTH in strip.pictures for strip in strips)
    write_json(folder / INDEX, {"captions": captions, "fits": dict(fits), "truth": truth})


def read_strips(folder: Path) -> KeptStrips | None:
    """Read an avatar's strips; None where none were kept.

    Raises:
        ArtifactError: if the list is damaged, or a picture that it names is missing.
    """
    if not (folder / INDEX).exists():
        return None
    try:
        index = _Index.model_validate(read_json(folder / INDEX))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ArtifactError(f"{folder / INDEX} is damaged: {where}: {first['msg']}") from None
    kept = KeptStrips(folder, tuple(index.captions), index.fits, index.truth)
    labels = (INPUT, *kept.fits, *((TRUTH,) if kept.truth else ()))
    for path in (kept.picture(n, label) for n in range(len(kept.captions)) for label in labels):
        if not path.is_file():
            raise ArtifactError(f"{folder / INDEX} names {path.name}, which is missing")
    return kept


def _picture(folder: Path, view: int, label: str) -> Path:
    return folder / f"{view}-{label.replace(' ', '_')}.jpg"
