"""High-speed source: real frames summed to real blur, the sharp ones between kept as the truth.

Conventions. The file was filmed at `fps`, whatever rate it plays at. Frame f of the clip is frame
`frames[0] + f * stride` of the file. Its blur is the mean of the `window` file frames around it in
linear light (`imaging/exposure.py`), none of them interpolated. The camera is as in `monocular`.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import UInt8
from pydantic import Field
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.config.reading import expand_environment, missing_file
from deblur_avatar.config.section import Count, Fraction, Params, Positive
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.imaging.exposure import (
    blur_windows,
    exposure_seconds,
    frames_with_whole_window,
)
from deblur_avatar.imaging.matting import background_plate, lift_person, trim_mattes
from deblur_avatar.sources.footage import Footage, read_footage
from deblur_avatar.sources.footage_camera import camera_of_footage
from deblur_avatar.sources.source import Segment


class HighSpeedParams(Params):
    """One video of one person by one still camera, filmed so fast that its frames are sharp.

    `path` may hold `$(VARIABLE:-default)`. Masks and poses are estimated from the summed frames.
    """

    source: Literal["high_speed"]
    path: str
    frames: tuple[Annotated[int, Field(ge=0)], int | None]  # first, one past last; null: all
    fps: Positive  # at which it was filmed
    window: Count  # frames that are summed, odd
    stride: Count  # frames from one sum to the next
    image_height: Count  # frames are scaled down to this height
    focal: Literal["estimated", "field_of_view"] | Positive  # pixels of the footage as recorded
    field_of_view: Annotated[float, Field(gt=5, lt=150)]  # degrees, longer side; the last resort
    held_out: Fraction  # last part of the clip, kept from training

    def load(
        self, body: Body, segment: Segment, generator: torch.Generator
    ) -> tuple[Clip, Reference]:
        """Read the video; its poses are not known."""
        return load_high_speed(self, segment)

    def missing_files(self, where: str) -> tuple[str, ...]:
        """The video, where it is not here."""
        return missing_file(self.path, f"{where}.path", "video and no folder")


def load_high_speed(params: HighSpeedParams, segment: Segment) -> tuple[Clip, Reference]:
    """Sum the frames of a high-speed video.

    Args:
        params: of the scene.
        segment: finds the person in the sharp frames, for the truth alone.

    Returns:
        A clip that knows its true blur, and every sharp frame as a view of the training camera.

    Raises:
        ConfigError: if there is no such video, or a window is even or longer than it.
        ArtifactError: if it cannot be decoded, or frames of it are repeated.
    """
    path = Path(expand_environment(params.path, "clip.path"))
    footage = read_footage(path, params.frames, 1, params.fps, params.image_height)
    _check_whole(footage, path)
    count = (len(footage.frames) - 1) // params.stride + 1
    sharp = footage.frames[: (count - 1) * params.stride + 1]
    whole = _frames_with_blur(params, count)
    windows = blur_windows(
        (frame.numpy() for frame in sharp), count, params.stride, params.window, "linear"
    )
    blurred = torch.from_numpy(np.stack(list(windows)))
    fps = params.fps / params.stride
    clip = Clip(
        frames=sharp[None, :: params.stride],
        mattes=None,
        recorded=(0,),
        train_camera=0,
        cameras=camera_of_footage(path, footage, params.focal, params.field_of_view, None, segment),
        timestamps=torch.arange(count) / fps,
        blurred=False,
        exposure=None,
        averaging_space="linear",
        held_out_from=max(1, round(count * (1 - params.held_out))),
        initial=None,
        exact=None,
        true_blur_srgb=None,
        true_blur_linear=blurred,
        true_blur_mattes=None,
        frame_indices=tuple(whole),
        true_blur_exposure=exposure_seconds(params.window, params.stride, fps),
    )
    return clip, _reference(params, clip, sharp, whole, segment)


def _check_whole(footage: Footage, path: Path) -> None:
    """Refuse files whose frames were not all taken: a sum over them is no exposure."""
    first = footage.numbers[0]
    if footage.numbers != tuple(range(first, first + len(footage.numbers))):
        raise ArtifactError(
            f"{path} repeats frames, so it was not filmed at one high rate; bring the file as the "
            "camera wrote it, or choose clip.frames without them"
        )


def _frames_with_blur(params: HighSpeedParams, count: int) -> range:
    try:
        whole = frames_with_whole_window(count, params.stride, params.window)
    except ValueError as error:
        raise ConfigError(f"clip.window: {error}") from None
    if not whole:
        raise ConfigError(
            f"clip.window: {params.window} frames are more than the video has, which gives {count} "
            f"instants {params.stride} frames apart; shorten the window"
        )
    return whole


def _reference(
    params: HighSpeedParams,
    clip: Clip,
    sharp: UInt8[Tensor, "M H W 3"],
    whole: Sequence[int],
    segment: Segment,
) -> Reference:
    """Every sharp frame near a blurred one, the person on black.

    It is a view of the frame whose middle it is nearest to, seen `offsets` seconds from there. Of
    the part kept from training only the middles are: other poses of it are not known.
    """
    mattes = segment(sharp)
    plates = [background_plate(sharp, mattes)] * len(sharp)
    mattes = trim_mattes(sharp, mattes, plates)
    instants = torch.arange(len(sharp))
    frames = (instants + params.stride // 2) // params.stride
    away = instants - frames * params.stride
    novel = frames >= clip.held_out_from
    chosen = (frames >= whole[0]) & (frames <= whole[-1]) & (~novel | (away == 0))
    return Reference(
        images=lift_person(sharp, mattes, plates, "linear")[chosen],
        mattes=mattes[chosen],
        seen=None,
        camera_indices=torch.zeros(int(chosen.sum()), dtype=torch.long),
        frame_indices=frames[chosen],
        novel_pose=novel[chosen].long(),
        background=(0.0, 0.0, 0.0),
        motion_times=None,
        motion=None,
        offsets=(away[chosen] / params.fps).float(),
    )
