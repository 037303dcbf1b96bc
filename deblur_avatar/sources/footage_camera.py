"""Camera of one's own footage: at the origin of the world, its focal length given or found.

The pictures are pinhole pictures with square pixels, their principal point in the middle.
"""

import logging
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.imaging.camera_motion import STILL, background_travel
from deblur_avatar.sources.focal_length import focal_of_files, focal_of_view
from deblur_avatar.sources.footage import Footage
from deblur_avatar.sources.self_calibration import calibrate_focal
from deblur_avatar.sources.source import Segment

logger = logging.getLogger(__name__)

AskedFocal = Literal["estimated", "field_of_view"] | float  # pixels of the footage as recorded


def camera_of_footage(
    path: Path,
    footage: Footage,
    asked: AskedFocal,
    field_of_view: float,
    mattes: UInt8[Tensor, "F H W"] | None,
    segment: Segment,
) -> Cameras:
    """The one camera that took some footage; the log says where its focal length comes from.

    Args:
        path: of the footage, whose metadata may tell.
        footage: as read.
        asked: a focal length, or how to find it.
        field_of_view: degrees along the longer side, where nothing else tells.
        mattes: of the person, where they came along.
        segment: finds them where they are needed and did not.
    """
    height, width = footage.frames.shape[1:3]
    scale = width / footage.recorded_size[0]
    focal, found = _focal_as_recorded(path, footage, asked, field_of_view, mattes, segment)
    logger.info("focal length %.0f px of %d: %s", focal, footage.recorded_size[0], found)
    focal *= scale
    return Cameras(
        Ks=torch.tensor([[[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]]),
        viewmats=torch.eye(4)[None],
        distortion=torch.zeros(1, 5),
        sizes=torch.tensor([[width, height]]),
        names=("camera",),
    )


def _focal_as_recorded(
    path: Path,
    footage: Footage,
    asked: AskedFocal,
    field_of_view: float,
    mattes: UInt8[Tensor, "F H W"] | None,
    segment: Segment,
) -> tuple[float, str]:
    size = footage.recorded_size
    if isinstance(asked, float | int):
        return float(asked), "given"
    guess = focal_of_view(field_of_view, size)
    of_view = f"field of view of {field_of_view:g} degrees"
    if asked == "field_of_view":
        return guess, of_view
    told = focal_of_files(path, size)
    if told is not None:
        return told, "from the file's metadata"
    mattes = segment(footage.frames) if mattes is None else mattes
    travel = background_travel(footage.frames, mattes)
    if travel is not None and travel < STILL:
        return guess, f"{of_view}; the camera stood still, so it cannot be estimated"
    estimated, how = calibrate_focal(footage.frames, mattes)
    if estimated is not None:
        return estimated / (footage.frames.shape[2] / size[0]), how
    logger.warning(
        "the focal length is a guess: %s. Set clip.focal (pixels) or clip.field_of_view if you "
        "know better",
        how,
    )
    return guess, of_view
