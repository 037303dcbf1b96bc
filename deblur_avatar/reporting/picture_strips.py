"""Strips of pictures: the same test view as every method renders it, cut to the person.

Conventions. `evaluate` leaves one folder a run: `views.json`, a list of views (`camera`, `frame`,
`novel_pose`), and for each the names of its pictures: `render`, `truth`, and `blurred`, the frame
that the training camera took at that time. Footage without a truth has no `truth`; its renders are
of the training camera.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from jaxtyping import UInt8
from pydantic import AfterValidator, BaseModel, ConfigDict, TypeAdapter, ValidationError

from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.imaging.contact_sheets import contact_sheet
from deblur_avatar.imaging.picture_files import read_picture
from deblur_avatar.reporting.results_table import method_order

Picture = UInt8[np.ndarray, "_ _ 3"]

INPUT, TRUTH = "blurred input", "truth"
LEFT_OUT = ("ceiling",)  # the oracle shows what a sharp input gives; one bound is enough to look at
BACKGROUND_STEP = 24  # sRGB codes by which the person differs from what is behind it
MARGIN = 0.06  # around the person, as a share of her longer side
HEIGHT, WIDTH = 320, 232  # pixels of a picture on the page
MAX_ENLARGED = 2.0  # times: more shows pixels, not the person


def _below(name: str) -> str:
    path = Path(name)
    if not name or "\0" in name or path.is_absolute() or ".." in path.parts:
        raise ValueError("a picture lies beside views.json")
    return name


FileName = Annotated[str, AfterValidator(_below)]


class _View(BaseModel):
    """An entry of `views.json`, as far as it is looked at here."""

    model_config = ConfigDict(frozen=True, strict=True)

    camera: str
    frame: int
    novel_pose: bool
    render: FileName
    blurred: FileName
    truth: FileName | None = None


@dataclass(frozen=True)
class Strip:
    """One moment: pictures by label, all of one size."""

    caption: str
    novel_pose: bool
    pictures: dict[str, Picture]


def strips_of_scene(folders: Mapping[str, Path], max_strips: int) -> list[Strip]:
    """Line up the views that all methods of a scene have rendered.

    Args:
        folders: what `evaluate` left, by method.
        max_strips: how many strips at most; the views kept are evenly spaced among those there are.

    Raises:
        ArtifactError: if a folder's list or one of its pictures is missing or damaged.
    """
    shown = [method for method in method_order(folders) if method not in LEFT_OUT]
    views = {method: _views(folders[method]) for method in shown}
    common = (
        [key for key in views[shown[0]] if all(key in views[m] for m in shown)] if shown else []
    )
    chosen = evenly_spaced(common, max_strips)
    return [_strip({m: (folders[m], views[m][key]) for m in shown}) for key in chosen]


def strip_sheet(strips: Sequence[Strip]) -> Picture:
    """All strips in one labelled picture, one a row."""
    labels = [label for strip in strips for label in strip.pictures]
    pictures = [picture for strip in strips for picture in strip.pictures.values()]
    return contact_sheet(pictures, len(strips[0].pictures), labels)


def _views(folder: Path) -> dict[tuple[str, int], _View]:
    path = folder / "views.json"
    try:
        views = TypeAdapter(list[_View]).validate_python(json.loads(path.read_text()))
    except OSError as error:
        raise ArtifactError(f"cannot read {path}: {error.strerror}; run `dvc repro`") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ArtifactError(
            f"{path} is damaged: {where}: {first['msg']}; run `dvc repro`"
        ) from None
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"{path} is damaged: {error!r}; run `dvc repro`") from None
    return {(view.camera, view.frame): view for view in views}


def _strip(views: Mapping[str, tuple[Path, _View]]) -> Strip:
    folder, view = next(iter(views.values()))
    truth = {TRUTH: read_picture(folder / view.truth)} if view.truth is not None else {}
    pictures = {method: read_picture(path / v.render) for method, (path, v) in views.items()}
    box = person_box([*truth.values(), *pictures.values()])
    cut = {label: _framed(picture, box) for label, picture in {**pictures, **truth}.items()}
    blurred = read_picture(folder / view.blurred)
    where = f"camera {view.camera}, frame {view.frame}"
    pose = ", a pose kept from training" if view.novel_pose else ""
    return Strip(
        caption=f"{where}{pose}. The input is what the training camera saw at that moment.",
        novel_pose=view.novel_pose,
        pictures={INPUT: _framed(blurred, person_box([blurred])), **_in_order(cut)},
    )


def _in_order(cut: dict[str, Picture]) -> dict[str, Picture]:
    """From the worst that blur can do to the truth: methods, then the oracle, then the truth."""
    bounds = [label for label in ("oracle", TRUTH) if label in cut]
    methods = [label for label in cut if label not in bounds]
    return {label: cut[label] for label in (*methods, *bounds)}


def person_box(pictures: Sequence[Picture]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of what differs from the background, with a margin.

    The background is the commonest colour of the first picture's rim.
    """
    rim = np.concatenate([pictures[0][0], pictures[0][-1], pictures[0][:, 0], pictures[0][:, -1]])
    colors, counts = np.unique(rim, axis=0, return_counts=True)
    background = colors[counts.argmax()].astype(int)
    height, width = len(pictures[0]), pictures[0].shape[1]
    different = np.zeros((height, width), bool)
    for picture in pictures:
        different |= np.abs(picture.astype(int) - background).max(-1) > BACKGROUND_STEP
    if not different.any():
        return 0, 0, width, height
    rows, columns = np.flatnonzero(different.any(1)), np.flatnonzero(different.any(0))
    margin = round(MARGIN * max(rows[-1] - rows[0], columns[-1] - columns[0]))
    return (
        max(int(columns[0]) - margin, 0),
        max(int(rows[0]) - margin, 0),
        min(int(columns[-1]) + margin + 1, width),
        min(int(rows[-1]) + margin + 1, height),
    )


def _framed(picture: Picture, box: tuple[int, int, int, int]) -> Picture:
    """Part of a picture in a frame of the page's size, as large as it fits."""
    left, top, right, bottom = box
    part = picture[top:bottom, left:right]
    scale = min(HEIGHT / part.shape[0], WIDTH / part.shape[1], MAX_ENLARGED)
    size = (max(round(part.shape[1] * scale), 1), max(round(part.shape[0] * scale), 1))
    kind = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    frame = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    frame[:] = picture[0, 0]
    above, beside = (HEIGHT - size[1]) // 2, (WIDTH - size[0]) // 2
    scaled = cv2.resize(part, size, interpolation=kind)
    frame[above : above + size[1], beside : beside + size[0]] = scaled
    return frame
