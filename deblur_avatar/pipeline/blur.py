"""Blur synthesis: the frame rate is raised, then windows of frames are averaged.

What the paper does to ZJU-MoCap, with classical optical flow in place of a learned interpolator.
Frames whose window leaves the clip are dropped. A clip that is blurred already passes through.
"""

import logging
from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.clip import BlurryClip, Clip
from deblur_avatar.config.section import Count, Params
from deblur_avatar.errors import ConfigError
from deblur_avatar.imaging.exposure import (
    blur_windows,
    exposure_seconds,
    frames_with_whole_window,
)
from deblur_avatar.imaging.interpolation import subframes


class BlurParams(Params):
    """Windows of interpolated sub-frames, as in the paper."""

    frames: Literal["interpolated", "true"]
    factor: Count  # sub-frames a frame
    window: Count  # sub-frames averaged, odd
    averaging_space: Literal["srgb", "linear"]


logger = logging.getLogger(__name__)

UNEVEN = 0.01  # share by which frame intervals may differ before they are no frame rate
SAME_EXPOSURE = 1e-3  # share by which the true blur's shutter may differ from the one asked for


def blur(clip: Clip, params: BlurParams) -> BlurryClip:
    """Blur every recorded camera of a clip.

    `held_out_from` becomes the position of the first frame kept that lies in the held-out part.
    Frames before it may still integrate over that part; `preprocess` keeps from training those
    whose shutter closed after it began (`imaging.exposure.frames_before`).

    Args:
        clip: any source's.
        params: of the scene.

    Raises:
        ConfigError: if the window is even or longer than the clip, the frames are not evenly
            spaced, or the true blur is asked for where there is none, or none for this window.
    """
    if clip.blurred:
        logger.info("the clip is blurred already; its frames pass through unchanged")
        return _passed_through(clip)
    kept = _kept_frames(clip, params)
    exposure = exposure_seconds(params.window, params.factor, _fps(clip))
    if params.frames == "true":
        frames, mattes = _true_blur(clip, params, exposure, kept)
    else:
        frames, mattes = _interpolated_blur(clip, params, kept)
    row = clip.recorded.index(clip.train_camera)
    chosen = slice(kept.start, kept.stop)
    return BlurryClip(
        frames=frames,
        mattes=mattes,
        landmarks=None if clip.landmarks is None else clip.landmarks[:, chosen],
        sharp_frames=clip.frames[row, chosen],
        sharp_mattes=None if clip.mattes is None else clip.mattes[row, chosen],
        recorded=clip.recorded,
        train_camera=clip.train_camera,
        cameras=clip.cameras,
        frame_indices=tuple(kept),
        timestamps=clip.timestamps[chosen],
        exposure=exposure,
        averaging_space=params.averaging_space,
        held_out_from=_position(kept, clip.held_out_from),
        initial=None if clip.initial is None else clip.initial.at(chosen),
        exact=None if clip.exact is None else clip.exact.at(chosen),
    )


def _fps(clip: Clip) -> float:
    intervals = clip.timestamps.double().diff()
    interval = float(intervals.mean())
    if (intervals - interval).abs().max() > UNEVEN * interval:
        raise ConfigError(
            "blur needs evenly spaced frames, but intervals range from "
            f"{intervals.min():.6f} to {intervals.max():.6f} s; resample the clip in its source"
        )
    return 1 / interval


def _kept_frames(clip: Clip, params: BlurParams) -> range:
    count = len(clip.timestamps)
    try:
        kept = frames_with_whole_window(count, params.factor, params.window)
    except ValueError as error:
        raise ConfigError(f"blur.window: {error}") from None
    if not kept or kept.start >= clip.held_out_from:
        raise ConfigError(
            f"blur.window: {params.window} sub-frames, {params.factor} a frame, leave no training "
            f"frame of a clip of {count} frames; shorten the window or take more frames"
        )
    return kept


def _position(kept: range, frame: int) -> int:
    """Where in `kept` the first frame at or after `frame` is; its length if there is none."""
    return min(max(frame - kept.start, 0), len(kept))


def _passed_through(clip: Clip) -> BlurryClip:
    return BlurryClip(
        frames=clip.frames,
        mattes=clip.mattes,
        landmarks=clip.landmarks,
        sharp_frames=None,
        sharp_mattes=None,
        recorded=clip.recorded,
        train_camera=clip.train_camera,
        cameras=clip.cameras,
        frame_indices=clip.numbered(range(len(clip.timestamps))),
        timestamps=clip.timestamps,
        exposure=clip.exposure,
        exposure_std=clip.exposure_std,
        averaging_space=clip.averaging_space,
        held_out_from=clip.held_out_from,
        initial=clip.initial,
        exact=clip.exact,
    )


def _true_blur(
    clip: Clip, params: BlurParams, exposure: float, kept: range
) -> tuple[UInt8[Tensor, "R F H W 3"], UInt8[Tensor, "R F H W"] | None]:
    frames = true_blur_of(clip, params)
    if frames is None or clip.true_blur_exposure is None:
        raise ConfigError(
            f"blur.frames: the source has no true blur in {params.averaging_space} light; "
            "use `interpolated`"
        )
    if not is_of_same_window(clip, exposure, kept):
        raise ConfigError(
            f"blur.frames: the source's true blur is of {clip.true_blur_exposure * 1e3:.2f} ms, "
            f"blur.window and blur.factor ask for {exposure * 1e3:.2f} ms; make clip.window and "
            "blur.window equal"
        )
    if len(clip.recorded) > 1:
        raise ConfigError("blur.frames: true blur is for clips of one recorded camera")
    mattes = clip.true_blur_mattes
    return frames[None], None if mattes is None else mattes[None]


def true_blur_of(clip: Clip, params: BlurParams) -> UInt8[Tensor, "E H W 3"] | None:
    """The physically true blur in the light asked for, where the source knows it."""
    return clip.true_blur_srgb if params.averaging_space == "srgb" else clip.true_blur_linear


def is_of_same_window(clip: Clip, exposure: float, kept: Sequence[int]) -> bool:
    """Whether the true blur is of the exposure, seconds, and of the frames asked for."""
    known = clip.true_blur_exposure or 0.0
    return abs(known - exposure) <= SAME_EXPOSURE * exposure and clip.frame_indices == tuple(kept)


def _interpolated_blur(
    clip: Clip, params: BlurParams, kept: range
) -> tuple[UInt8[Tensor, "R F H W 3"], UInt8[Tensor, "R F H W"] | None]:
    cameras, _, height, width, _ = clip.frames.shape
    frames = torch.empty((cameras, len(kept), height, width, 3), dtype=torch.uint8)
    mattes = None if clip.mattes is None else torch.empty_like(frames[..., 0])

    def blur_camera(row: int) -> None:
        raised = subframes(pictures_of(clip, row), params.factor)
        count = len(clip.timestamps)
        windows = blur_windows(raised, count, params.factor, params.window, params.averaging_space)
        name = f"blur {clip.cameras.names[clip.recorded[row]]}"
        for position, picture in enumerate(run.progress(windows, name, len(kept))):
            frames[row, position] = torch.from_numpy(picture[..., :3])
            if mattes is not None:
                mattes[row, position] = torch.from_numpy(picture[..., 3])

    run.in_threads(blur_camera, range(cameras))
    return frames, mattes


def pictures_of(clip: Clip, row: int, stride: int = 1) -> Iterator[UInt8[np.ndarray, "H W D"]]:
    """One camera's frames, each with its matte as a fourth channel where there are mattes."""
    for index in range(0, len(clip.timestamps), stride):
        frame = clip.frames[row, index].numpy()
        if clip.mattes is None:
            yield frame
        else:
            yield np.dstack([frame, clip.mattes[row, index].numpy()])
