"""Frames that another program has deblurred: a folder of pictures, or a video."""

import sys
from pathlib import Path

import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.picture_files import read_picture
from deblur_avatar.sources.footage import PICTURES, files_in_order
from deblur_avatar.sources.video_files import read_video

AS_IT_IS = sys.maxsize  # rows that no video is scaled down to


def read_deblurred(
    path: Path, blurred: UInt8[Tensor, "F H W 3"], where: str
) -> UInt8[Tensor, "F H W 3"]:
    """Read one frame for each blurred one, of its size.

    Args:
        path: a folder, whose pictures are taken in the natural order of their names, or a video.
        blurred: what was to be deblurred.
        where: the parameter that names the path, for errors.

    Raises:
        ArtifactError: if there is no such file or folder, it cannot be read, or it holds other
            than one frame for each blurred one, of its size.
    """
    height, width = blurred.shape[1:3]
    if path.is_dir():
        frames = _pictures(path, len(blurred), where)
    elif path.is_file():
        frames = list(read_video(path, 0, None, AS_IT_IS).frames)
        _check_count(len(frames), len(blurred), path, "frames", where)
    else:
        raise ArtifactError(
            f"{where}: no folder and no video {path}; put the deblurred frames there, or leave it "
            "empty to have them deblurred here"
        )
    for index, frame in enumerate(frames):
        if frame.shape != blurred.shape[1:]:
            raise ArtifactError(
                f"{where}: frame {index} of {path} is {frame.shape[1]} x {frame.shape[0]} pixels, "
                f"the blurred frames are {width} x {height}; deblur those, uncropped"
            )
    return torch.stack(frames)


def _pictures(folder: Path, wanted: int, where: str) -> list[UInt8[Tensor, "H W 3"]]:
    files = files_in_order(folder, PICTURES)
    _check_count(len(files), wanted, folder, "pictures", where)
    return [torch.from_numpy(read_picture(file)) for file in files]


def _check_count(found: int, wanted: int, path: Path, what: str, where: str) -> None:
    if found != wanted:
        raise ArtifactError(
            f"{where}: {path} holds {found} {what}, wanted {wanted}: one for each of the blurred "
            "observations' frames, in order"
        )
