"""Evaluation of deblurring in the picture on persons whom no deblurrer was trained on.

Every deblurrer sees the same blurred clips; each window of sub-frames is scored by itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.artifacts.deblurring_clips import DeblurringClips
from deblur_avatar.config.section import Count, Params
from deblur_avatar.evaluation.deblurring_measures import deblurring_measures
from deblur_avatar.imaging.deblurring.deblurrer import Deblurrer, Pictures
from deblur_avatar.imaging.deblurring.kinds import DeblurrerParams

BLURRED = "blurred"  # what is scored beside the deblurrers: frames as they are


class ScoreDstnetParams(Params):
    """What is compared, and what is shown of it."""

    deblurrers: dict[str, DeblurrerParams]  # by the name that scores give them
    shown_window: Count  # sub-frames, of the strip's pictures


@dataclass(frozen=True)
class DeblurringScores:
    """PSNR of frames against the sharp ones, and a picture of them."""

    scores: dict[str, Any]
    strip: UInt8[Tensor, "H W 3"]  # a row a person: blurred, each deblurrer's, sharp


def score_deblurrers(clips: DeblurringClips, params: ScoreDstnetParams) -> DeblurringScores:
    """Mean PSNR in dB over frames and persons, a window at a time.

    `psnr_person` is over the pixels that the person covers in the sharp or the blurred frame,
    `psnr` over all, `psnr_matte` that of coverage.
    """
    scores: dict[str, Any] = {}
    rows: list[list[Tensor]] = [[] for _ in clips.sharp]
    for index, window in enumerate(clips.windows):
        made = _by_name(clips, index, params.deblurrers)
        scores[str(window)] = {
            name: _means(pictures, made[BLURRED], clips) for name, pictures in made.items()
        }
        if window == params.shown_window:
            middle = clips.sharp.shape[1] // 2
            for person, row in enumerate(rows):
                row += [of[person].frames[middle] for of in made.values()]
                row.append(clips.sharp[person, middle])
    return DeblurringScores(scores, torch.cat([torch.cat(row, 1) for row in rows if row]))


def _by_name(
    clips: DeblurringClips, index: int, deblurrers: Mapping[str, Deblurrer]
) -> dict[str, list[Pictures]]:
    """Each person's pictures in one window, as they are and from every deblurrer."""
    pairs = zip(clips.blurred[:, index], clips.blurred_mattes[:, index], strict=True)
    blurred = [Pictures(frames, mattes) for frames, mattes in pairs]
    made = {BLURRED: blurred}
    for name, deblurrer in deblurrers.items():
        made[name] = [
            deblurrer.deblur(one, space, [slice(0, len(one.frames))])[0]
            for one, space in zip(blurred, clips.averaging_spaces, strict=True)
        ]
    return made


def _means(
    made: list[Pictures], blurred: list[Pictures], clips: DeblurringClips
) -> dict[str, float]:
    found: dict[str, list[Tensor]] = {}
    for person, (one, given) in enumerate(zip(made, blurred, strict=True)):
        sharp = Pictures(clips.sharp[person], clips.sharp_mattes[person])
        for name, scores in deblurring_measures(one, given, sharp).items():
            found.setdefault(name, []).append(scores)
    return {name: float(torch.cat(scores).mean()) for name, scores in found.items()}
