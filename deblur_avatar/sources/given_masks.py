"""Given masks: a folder of pictures from another program, one for each frame.

A pixel that is not black is person, whatever its value: label pictures count as well as 0 and 255.
Grey pictures with many values up to white are soft masks and keep them as coverage: of 8 or 16
bits, in one channel or in equal ones. So do black and white that a lossy codec left a little off. A
palette's colours do not count, its indices do: index 0 is background.
"""

from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.imaging.picture_files import read_labels
from deblur_avatar.sources.footage import PICTURES, files_in_order

SAME_SHAPE = 0.02  # share by which a mask's aspect may differ from its frame's
SOFT_VALUES, WHITE = 16, 250  # so many values up to there make a mask soft
LOOKED_AT = 12  # masks that tell whether a folder's are soft: one that shows nobody does not say
RINGING = 16  # codes that a lossy codec leaves black and white off, each in two values or more


def read_masks(
    folder: Path, numbers: tuple[int, ...], total: int | None, size: tuple[int, int]
) -> UInt8[Tensor, "F H W"]:
    """Mattes of some frames, brought to the size of the frames as they are used.

    Args:
        folder: masks in the order of the footage's frames, one for each.
        numbers: frames wanted.
        total: frames of the footage, where known.
        size: width and height wanted.

    Raises:
        ArtifactError: if masks are missing, damaged, of another shape than frames, or all black.
    """
    if not folder.is_dir():
        raise ArtifactError(f"no folder {folder}; check clip.masks")
    files = files_in_order(folder, PICTURES)
    if len(files) <= max(numbers) or total not in (None, len(files)):
        raise ArtifactError(
            f"{folder} holds {len(files)} masks, the footage has {total or max(numbers) + 1} "
            "frames; one mask is wanted for every frame, in their order"
        )
    soft = any(_is_soft(files[number]) for number in evenly_spaced(numbers, LOOKED_AT))
    mattes = torch.stack([_read(files[number], size, soft) for number in numbers])
    if not mattes.any():
        raise ArtifactError(f"{folder}: every mask is black; what is not black is the person")
    return mattes


def _is_soft(path: Path) -> bool:
    values, grey = read_labels(path)
    return grey and _is_coverage(values)


def _read(path: Path, size: tuple[int, int], soft: bool) -> UInt8[Tensor, "H W"]:
    """One mask, of a folder that holds soft ones or seems to hold none."""
    values, grey = read_labels(path)
    height, width = values.shape
    if abs(width / height - size[0] / size[1]) > SAME_SHAPE * size[0] / size[1]:
        raise ArtifactError(
            f"{path} is {width} x {height}, of another shape than the frames ({size[0]} x {size[1]}"
            " as used); masks must show the whole frame"
        )
    soft = grey and (soft or _is_coverage(values))
    matte = values if soft else np.where(values > 0, 255, 0).astype(np.uint8)
    scaled = (
        matte if (width, height) == size else cv2.resize(matte, size, None, 0, 0, cv2.INTER_AREA)
    )
    return torch.from_numpy(np.ascontiguousarray(scaled))


def _is_coverage(greys: UInt8[np.ndarray, "H W"]) -> bool:
    """Whether greys are shares of pixels; labels stay far below white, or one is white."""
    found = np.unique(greys)
    many = len(found) >= SOFT_VALUES and found[-1] >= WHITE
    dark, bright = (found < RINGING).sum(), (found > 255 - RINGING).sum()
    return bool(many or (min(dark, bright) > 1 and dark + bright == len(found)))
