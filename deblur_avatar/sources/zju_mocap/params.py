"""Parameters of a sequence in ZJU-MoCap's layout."""

from typing import Annotated, Literal

from pydantic import Field

from deblur_avatar.config.section import (
    Count,
    Fraction,
    Params,
    Positive,
)


class ZjuMocapParams(Params):
    """A sequence in ZJU-MoCap's raw layout (docs/zju-mocap.md).

    `root` may hold `$(VARIABLE:-default)`. Cameras are counted from 0 in the order of `annots.npy`,
    frames as it lists them.
    """

    source: Literal["zju_mocap"]
    root: str
    frames: tuple[Annotated[int, Field(ge=0)], int | None]  # first, one past last (null: all)
    stride: Count  # every n-th of them is a frame of the clip
    fps: Positive  # of the recording
    image_height: Count  # pictures that are taller are scaled down to this
    train_camera: Annotated[int, Field(ge=0)]
    test_cameras: tuple[Annotated[int, Field(ge=0)], ...] | Literal["all"]  # all others
    test_stride: Count  # frames of the clip between two test views
    pose_cameras: tuple[Annotated[int, Field(ge=0)], ...]  # recorded too, for estimated poses
    mask_folders: Annotated[tuple[Literal["mask", "mask_cihp"], ...], Field(min_length=1)]
    mask_dilation: Annotated[int, Field(ge=0)]  # pixels of the pictures as filmed
    background: Literal["black", "filmed"]  # of the clip; black is what masks leave out
    poses: Literal["new_params", "none"]
    held_out: Fraction  # last part of the clip, kept from training
