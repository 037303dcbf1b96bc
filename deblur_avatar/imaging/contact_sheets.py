"""Contact sheets: rows of labelled pictures in one picture."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

GAP = 6  # pixels between pictures and around them
LABEL_HEIGHT = 22  # pixels above each row
TEXT_HEIGHT = 11  # pixels, of a capital letter
BACKGROUND = 245  # sRGB code of the paper
INK = 40  # sRGB code of the letters


def contact_sheet(
    images: Sequence[UInt8[np.ndarray, "_ _ 3"]],
    columns: int,
    labels: Sequence[str] | None = None,
) -> UInt8[np.ndarray, "_ _ 3"]:
    """Lay pictures out in rows, left to right, each under its label.

    Cells are as large as the largest picture; smaller ones are centred, none is scaled. Labels
    wider than their cell are shown smaller.

    Args:
        images: sRGB, sizes may differ.
        columns: pictures a row.
        labels: one a picture, or none.

    Raises:
        ValueError: for no picture, fewer than one column, or another number of labels.
    """
    if not images or columns < 1:
        raise ValueError(f"{len(images)} pictures in {columns} columns make no sheet")
    if labels is not None and len(labels) != len(images):
        raise ValueError(f"{len(images)} pictures have {len(labels)} labels")
    head = LABEL_HEIGHT if labels is not None else 0
    height = max(image.shape[0] for image in images)
    width = max(image.shape[1] for image in images)
    columns = min(columns, len(images))
    rows = -(-len(images) // columns)
    sheet = np.full(
        (rows * (head + height + GAP) + GAP, columns * (width + GAP) + GAP, 3), BACKGROUND, np.uint8
    )
    for index, image in enumerate(images):
        row, column = divmod(index, columns)
        top, left = GAP + row * (head + height + GAP), GAP + column * (width + GAP)
        if labels is not None:
            _write(sheet, labels[index], left, top, width)
        top += head + (height - image.shape[0]) // 2
        left += (width - image.shape[1]) // 2
        sheet[top : top + image.shape[0], left : left + image.shape[1]] = image
    return sheet


def _write(sheet: UInt8[np.ndarray, "_ _ 3"], text: str, left: int, top: int, width: int) -> None:
    face = cv2.FONT_HERSHEY_SIMPLEX
    scale = cv2.getFontScaleFromHeight(face, TEXT_HEIGHT, 1)
    (wide, _), _ = cv2.getTextSize(text, face, scale, 1)
    scale *= min(1.0, width / max(wide, 1))
    origin = (left, top + LABEL_HEIGHT - (LABEL_HEIGHT - TEXT_HEIGHT) // 2)
    cv2.putText(sheet, text, origin, face, scale, (INK, INK, INK), 1, cv2.LINE_AA)
