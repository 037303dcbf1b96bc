"""From sharp frames to blurred ones: the frame rate is raised, then windows of it are averaged.

What the paper does to ZJU-MoCap, with classical optical flow in place of a learned interpolator.
Frames whose window leaves the clip are dropped. A clip that is blurred already passes through.
"""

import logging
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from itertools import pairwise
from typing import Any, Literal

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.clip import BlurryClip, Clip
from deblur_avatar.config.section import Count, Params
from deblur_avatar.errors import ConfigError
from deblur_avatar.imaging import metrics
from deblur_avatar.imaging.exposure import (
    blur_windows,
    exposure_seconds,
    frames_with_whole_window,
)
from deblur_avatar.imaging.interpolation import (
    estimate_flow,
    interpolate,
    subframes,
)


class BlurParams(Params):
    """Windows of interpolated sub-frames, as in the paper."""

    frames: Literal["interpolated", "true"]
    factor: Count  # sub-frames a frame
    window: Count  # sub-frames averaged, odd
    light: Literal["srgb", "linear"]


logger = logging.getLogger(__name__)

UNEVEN = 0.01  # share by which frame intervals may differ before they are no frame rate
SAME_EXPOSURE = 1e-3  # share by which the true blur's shutter may differ from the one asked for


def blur(clip: Clip, params: BlurParams) -> tuple[BlurryClip, dict[str, Any]]:
    """Blur every recorded camera of a clip, and measure how well.

    `held_out_from` becomes the position of the first frame kept that lies in the held-out part.
    Frames before it may still integrate over that part; `preprocess` keeps from training those
    whose shutter closed after it began (`imaging.exposure.frames_before`).

    Args:
        clip: any source's.
        params: of the scene.

    Returns:
        The blurred clip, and the metrics: of the interpolation (every second frame held out), and
        of the blurred frames against the physically true blur where that is known.

    Raises:
        ConfigError: if the window is even or longer than the clip, the frames are not evenly
            spaced, or the true blur is asked for where there is none, or none for this window.
    """
    if clip.blurred:
        logger.info("the clip is blurred already; its frames pass through unchanged")
        return _passed_through(clip), {"frames": _counts(clip, range(len(clip.timestamps)))}
    kept = _kept_frames(clip, params)
    exposure = exposure_seconds(params.window, params.factor, _fps(clip))
    if params.frames == "true":
        frames, mattes = _true_blur(clip, params, exposure, kept)
    else:
        frames, mattes = _interpolated_blur(clip, params, kept)
    row = clip.recorded.index(clip.train_camera)
    chosen = slice(kept.start, kept.stop)
    blurry = BlurryClip(
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
        light=params.light,
        held_out_from=_position(kept, clip.held_out_from),
        initial=None if clip.initial is None else clip.initial.at(chosen),
        exact=None if clip.exact is None else clip.exact.at(chosen),
    )
    return blurry, _measure(clip, blurry, params, kept)


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
        frame_indices=tuple(range(len(clip.timestamps))),
        timestamps=clip.timestamps,
        exposure=clip.exposure,
        light=clip.light,
        held_out_from=clip.held_out_from,
        initial=clip.initial,
        exact=clip.exact,
    )


def _true_blur(
    clip: Clip, params: BlurParams, exposure: float, kept: range
) -> tuple[UInt8[Tensor, "R F H W 3"], UInt8[Tensor, "R F H W"] | None]:
    frames = _true_frames(clip, params)
    if frames is None or clip.true_blur_exposure is None:
        raise ConfigError(
            f"blur.frames: the source has no true blur in {params.light} light; use `interpolated`"
        )
    if not _of_same_window(clip, exposure, kept):
        raise ConfigError(
            f"blur.frames: the source's true blur is of {clip.true_blur_exposure * 1e3:.2f} ms, "
            f"blur.window and blur.factor ask for {exposure * 1e3:.2f} ms; make clip.window and "
            "blur.window equal"
        )
    if len(clip.recorded) > 1:
        raise ConfigError("blur.frames: true blur is for clips of one recorded camera")
    mattes = clip.true_blur_mattes
    return frames[None], None if mattes is None else mattes[None]


def _true_frames(clip: Clip, params: BlurParams) -> UInt8[Tensor, "E H W 3"] | None:
    return clip.true_blur_srgb if params.light == "srgb" else clip.true_blur_linear


def _of_same_window(clip: Clip, exposure: float, kept: range) -> bool:
    known = clip.true_blur_exposure or 0.0
    return abs(known - exposure) <= SAME_EXPOSURE * exposure and clip.frame_indices == tuple(kept)


def _interpolated_blur(
    clip: Clip, params: BlurParams, kept: range
) -> tuple[UInt8[Tensor, "R F H W 3"], UInt8[Tensor, "R F H W"] | None]:
    cameras, _, height, width, _ = clip.frames.shape
    frames = torch.empty((cameras, len(kept), height, width, 3), dtype=torch.uint8)
    mattes = None if clip.mattes is None else torch.empty_like(frames[..., 0])

    def blur_camera(row: int) -> None:
        raised = subframes(_pictures(clip, row), params.factor)
        count = len(clip.timestamps)
        windows = blur_windows(raised, count, params.factor, params.window, params.light)
        name = f"blur {clip.cameras.names[clip.recorded[row]]}"
        for position, picture in enumerate(run.progress(windows, name, len(kept))):
            frames[row, position] = torch.from_numpy(picture[..., :3])
            if mattes is not None:
                mattes[row, position] = torch.from_numpy(picture[..., 3])

    # Side by side: OpenCV and NumPy leave the interpreter to others while they work.
    with ThreadPoolExecutor(os.cpu_count()) as workers:
        list(workers.map(blur_camera, range(cameras)))
    return frames, mattes


def _pictures(clip: Clip, row: int, stride: int = 1) -> Iterator[UInt8[np.ndarray, "H W D"]]:
    """One camera's frames, each with its matte as a fourth channel where there are mattes."""
    for index in range(0, len(clip.timestamps), stride):
        frame = clip.frames[row, index].numpy()
        if clip.mattes is None:
            yield frame
        else:
            yield np.dstack([frame, clip.mattes[row, index].numpy()])


def _measure(clip: Clip, blurry: BlurryClip, params: BlurParams, kept: range) -> dict[str, Any]:
    row = clip.recorded.index(clip.train_camera)
    exposure = blurry.exposure or 0.0
    truth, against_truth = _true_frames(clip, params), None
    if truth is not None and _of_same_window(clip, exposure, kept):
        against_truth = _scores(blurry.frames[row], truth, clip.true_blur_mattes)
    return {
        "blur": against_truth,
        "interpolation": _interpolation_scores(clip, row),
        "frames": _counts(clip, kept),
        "window": params.window,
        "factor": params.factor,
        "exposure_ms": 1e3 * exposure,
        "light": params.light,
        "source": params.frames,
    }


def _counts(clip: Clip, kept: range) -> dict[str, int]:
    training = _position(kept, clip.held_out_from)
    return {
        "clip": len(clip.timestamps),
        "kept": len(kept),
        "dropped": len(clip.timestamps) - len(kept),
        "held_out": len(kept) - training,
    }


def _interpolation_scores(clip: Clip, row: int) -> dict[str, float | None] | None:
    """Draw every second frame of the training camera from its neighbours, and compare.

    `plain` is the mean of the two neighbours, which any interpolation must beat.
    """
    even = list(_pictures(clip, row, stride=2))
    if len(even) < 2:
        return None
    drawn, plain = [], []
    pairs = run.progress(list(pairwise(even)), "interpolation, held-out frames")
    for a, b in pairs:
        drawn.append(interpolate(a, b, estimate_flow(a, b), Fraction(1, 2))[..., :3])
        plain.append(cv2.addWeighted(a, 0.5, b, 0.5, 0)[..., :3])
    odd = slice(1, 2 * len(drawn), 2)
    truth = clip.frames[row, odd]
    mattes = None if clip.mattes is None else clip.mattes[row, odd]
    plain_scores = _scores(torch.from_numpy(np.stack(plain)), truth, mattes)
    return {
        **_scores(torch.from_numpy(np.stack(drawn)), truth, mattes),
        "psnr_plain": plain_scores["psnr"],
        "psnr_person_plain": plain_scores["psnr_person"],
    }


def _scores(
    frames: UInt8[Tensor, "F H W 3"],
    truth: UInt8[Tensor, "F H W 3"],
    mattes: UInt8[Tensor, "F H W"] | None,
) -> dict[str, float | None]:
    """Means over frames; `psnr_person` is over the pixels the person touches."""
    scores: dict[str, list[Tensor]] = {"psnr": [], "ssim": [], "psnr_person": []}
    for index in range(len(frames)):
        frame, true = frames[index : index + 1] / 255, truth[index : index + 1] / 255
        scores["psnr"].append(metrics.psnr(frame, true))
        scores["ssim"].append(metrics.ssim(frame, true))
        if mattes is not None and mattes[index].any():
            scores["psnr_person"].append(metrics.psnr(frame, true, mattes[index : index + 1] > 0))
    return {
        name: float(torch.cat(values).mean()) if values else None for name, values in scores.items()
    }
