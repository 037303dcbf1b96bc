"""Evaluation of made blur: interpolated frames against frames left out, averages against true blur.

Apart from `blur`, so that no change to a metric makes a clip anew.
"""

from fractions import Fraction
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.clip import BlurryClip, Clip
from deblur_avatar.imaging import metrics
from deblur_avatar.imaging.interpolation import estimate_flow, interpolate
from deblur_avatar.pipeline.blur import BlurParams, is_of_same_window, pictures_of, true_blur_of


def score_blur(clip: Clip, blurry: BlurryClip, params: BlurParams) -> dict[str, Any]:
    """Score the blurred frames of one clip.

    Args:
        clip: what was blurred.
        blurry: what `blur` made of it.
        params: how.

    Returns:
        `interpolation`: every second frame, guessed from its neighbours; `blur`: the blurred frames
        against the physically true blur, None where that is not known; and what was averaged.
        Of a clip that was blurred when it came, its numbers of frames alone.
    """
    if clip.blurred:
        return {"frames": _counts(clip, blurry)}
    row = clip.recorded.index(clip.train_camera)
    exposure = blurry.exposure or 0.0
    truth, against_truth = true_blur_of(clip, params), None
    if truth is not None and is_of_same_window(clip, exposure, blurry.frame_indices):
        against_truth = _scores(blurry.frames[row], truth, clip.true_blur_mattes)
    return {
        "blur": against_truth,
        "interpolation": _interpolation_scores(clip, row),
        "frames": _counts(clip, blurry),
        "window": params.window,
        "factor": params.factor,
        "exposure_ms": 1e3 * exposure,
        "averaging_space": params.averaging_space,
        "source": params.frames,
    }


def _counts(clip: Clip, blurry: BlurryClip) -> dict[str, int]:
    kept = len(blurry.frame_indices)
    return {
        "clip": len(clip.timestamps),
        "kept": kept,
        "dropped": len(clip.timestamps) - kept,
        "held_out": kept - blurry.held_out_from,
    }


def _interpolation_scores(clip: Clip, row: int) -> dict[str, float | None] | None:
    """Interpolate every second frame of the training camera, and compare.

    `plain` is the mean of the two neighbours, which any interpolation must beat.
    """
    even = list(pictures_of(clip, row, stride=2))
    if len(even) < 2:
        return None
    between, plain = [], []
    pairs = run.progress(list(pairwise(even)), "interpolation, held-out frames")
    for a, b in pairs:
        between.append(interpolate(a, b, estimate_flow(a, b), Fraction(1, 2))[..., :3])
        plain.append(cv2.addWeighted(a, 0.5, b, 0.5, 0)[..., :3])
    odd = slice(1, 2 * len(between), 2)
    truth = clip.frames[row, odd]
    mattes = None if clip.mattes is None else clip.mattes[row, odd]
    plain_scores = _scores(torch.from_numpy(np.stack(plain)), truth, mattes)
    return {
        **_scores(torch.from_numpy(np.stack(between)), truth, mattes),
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
