"""ZJU-MoCap pictures and masks: as filmed, or the person alone on black.

A mask has the path of its picture, as `.png`, below `mask` or `mask_cihp`. What is not 0 is the
person, whatever the label; several masks of one picture are joined.
"""

import logging
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.picture_files import read_mask, read_picture
from deblur_avatar.sources.folders import file_inside

logger = logging.getLogger(__name__)


def mask_folders_here(root: Path, wanted: Sequence[str]) -> list[str]:
    """Those of the wanted folders that there are.

    Raises:
        ArtifactError: if there is none.
    """
    here = [name for name in wanted if (root / name).is_dir()]
    if not here:
        raise ArtifactError(f"{root} has no folder of masks; wanted {' or '.join(wanted)}")
    for name in set(wanted) - set(here):
        logger.warning("%s has no folder %s; the masks of %s alone are used", root, name, here)
    return here


def picture_size(root: Path, name: str) -> tuple[int, int]:
    """Width and height of a picture as filmed."""
    height, width = read_picture(file_inside(root, name)).shape[:2]
    return width, height


def read_person(
    root: Path, name: str, folders: Sequence[str], dilation: int, on_black: bool
) -> tuple[UInt8[Tensor, "H W 3"], UInt8[Tensor, "H W"]]:
    """Read a picture and its matte.

    Args:
        root: of the sequence.
        name: of the picture, below the root.
        folders: of masks.
        dilation: pixels by which masks grow on every side.
        on_black: whether what the mask leaves out is made black.

    Raises:
        ArtifactError: if a file is missing, damaged, or of another size than its picture.
    """
    picture = read_picture(file_inside(root, name))
    mask = np.zeros(picture.shape[:2], bool)
    for folder in folders:
        mask |= _mask(root, folder, name, mask.shape)
    if dilation:
        disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * dilation + 1,) * 2)
        mask = cv2.dilate(mask.astype(np.uint8), disk) > 0
    if on_black:
        picture = picture * mask[..., None]
    return torch.from_numpy(picture), torch.from_numpy(mask.astype(np.uint8) * 255)


def _mask(root: Path, folder: str, name: str, shape: tuple[int, ...]) -> Bool[np.ndarray, "H W"]:
    path = file_inside(root, str(Path(folder, name).with_suffix(".png")))
    mask = read_mask(path)
    if mask.shape != shape:
        raise ArtifactError(
            f"{path} has {mask.shape[1]} x {mask.shape[0]} pixels, its picture {shape[1]} x "
            f"{shape[0]}; masks must be made of the same pictures"
        )
    return mask
