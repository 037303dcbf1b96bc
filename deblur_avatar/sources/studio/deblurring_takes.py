"""Takes to learn deblurring from: strangers who improvise before one camera, blurred and sharp.

Conventions. As `source.py`, with the same lamps and instants a frame. A take is one person in one
motion; every take has seeds of its own, so that there may be more of them without changing one.
Takes are by turns as the studio's tuning scene is (averaged in sRGB, no noise) and as its report
scenes are (averaged as light, a sensor's noise).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch
from jaxtyping import UInt8
from pydantic import Field
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.deblurring_clips import DeblurringClips
from deblur_avatar.config.section import Count, NonNegative, Params, Positive
from deblur_avatar.imaging.color import srgb_to_linear
from deblur_avatar.imaging.exposure import (
    AveragingSpace,
    blur_windows,
    frames_with_whole_window,
)
from deblur_avatar.rendering.mesh_rendering import View, render
from deblur_avatar.sources.studio.cameras import RingParams, place_cameras
from deblur_avatar.sources.studio.improvised import improvise
from deblur_avatar.sources.studio.sensor import NoiseParams, gains, record
from deblur_avatar.sources.studio.source import LIGHTING, SUBFRAMES, encode
from deblur_avatar.sources.studio.strangers import draw_person
from deblur_avatar.sources.studio.unfitted_body import UnfittedParams, swing_of_joints

HEIGHTS = 0.7, 1.7  # metres, of the camera
SPACES: tuple[AveragingSpace, ...] = ("srgb", "linear")  # of takes by turns; the latter are noisy


class TakesParams(Params):
    """What the takes are like."""

    frames: Annotated[int, Field(ge=2)]  # of each
    fps: Positive
    windows: Annotated[tuple[Count, ...], Field(min_length=1)]  # sub-frames averaged, odd
    image_size: Annotated[int, Field(ge=8)]  # square, pixels
    samples_per_axis: Count
    fields: tuple[Positive, Positive]  # metres seen from top to bottom: least and most
    betas_deviation: NonNegative
    unfitted_body: UnfittedParams
    noise: NoiseParams


@dataclass(frozen=True)
class Take:
    """One person's frames, coverage as the fourth channel."""

    sharp: UInt8[Tensor, "F H W 4"]
    blurred: UInt8[Tensor, "L F H W 4"]


def film_takes(params: TakesParams, body: Body, seeds: Sequence[int]) -> DeblurringClips:
    """Film a take for each seed."""
    takes, spaces = [], []
    for index, seed in enumerate(run.progress(seeds, "filming takes")):
        spaces.append(SPACES[index % len(SPACES)])
        takes.append(film_take(params, body, spaces[-1], torch.Generator().manual_seed(seed)))
    sharp = torch.stack([take.sharp for take in takes])
    blurred = torch.stack([take.blurred for take in takes])
    return DeblurringClips(
        sharp=sharp[..., :3],
        sharp_mattes=sharp[..., 3],
        blurred=blurred[..., :3],
        blurred_mattes=blurred[..., 3],
        windows=params.windows,
        averaging_spaces=tuple(spaces),
    )


def film_take(
    params: TakesParams, body: Body, space: AveragingSpace, generator: torch.Generator
) -> Take:
    """Draw a person, a motion and a camera, and film them."""
    person = draw_person(body, params.betas_deviation, params.unfitted_body, generator)
    motion = improvise(generator)
    view = _view(params, generator)
    reach = -(-(max(params.windows) // 2) // SUBFRAMES)  # frames before and after, for exposures
    count = params.frames + 2 * reach
    times = torch.arange(SUBFRAMES * (count - 1) + 1, dtype=torch.float64)
    times = times / (SUBFRAMES * params.fps)
    moves = motion(times, float(times[-1]))
    swing = swing_of_joints(body, person.betas, moves, times)
    moves = replace(moves, swing=params.unfitted_body.swing * swing)
    instants = [
        encode(render(vertices, person.mesh, view, LIGHTING)) for vertices in person.posed(moves)
    ]
    blurred = [_blurred(instants, count, window, reach, space) for window in params.windows]
    if space == "linear":
        blurred = [_recorded(frames, params.noise, generator) for frames in blurred]
    middle = slice(SUBFRAMES * reach, SUBFRAMES * (reach + params.frames), SUBFRAMES)
    return Take(torch.from_numpy(np.stack(instants[middle])), torch.stack(blurred))


def _view(params: TakesParams, generator: torch.Generator) -> View:
    height, field = torch.rand(2, generator=generator).tolist()
    low, high = params.fields
    ring = RingParams(
        training_height=HEIGHTS[0] + (HEIGHTS[1] - HEIGHTS[0]) * height,
        test_heights=(1.0,),  # no camera tests
        test_degrees=0.0,
        field=math.exp(math.log(low) + math.log(high / low) * field),
    )
    return View.of(place_cameras(0, params.image_size, ring), 0, params.samples_per_axis)


def _blurred(
    instants: Sequence[UInt8[np.ndarray, "H W 4"]],
    count: int,
    window: int,
    reach: int,
    space: AveragingSpace,
) -> UInt8[Tensor, "F H W 4"]:
    """The frames that windows of every length have."""
    frames = frames_with_whole_window(count, SUBFRAMES, window)
    made = list(blur_windows(instants, count, SUBFRAMES, window, space))
    kept = made[reach - frames.start : count - reach - frames.start]
    return torch.from_numpy(np.stack(kept))


def _recorded(
    frames: UInt8[Tensor, "F H W 4"], noise: NoiseParams, generator: torch.Generator
) -> UInt8[Tensor, "F H W 4"]:
    """As a sensor reads them where the matte has anything."""
    light = srgb_to_linear(frames[..., :3].float() / 255)
    read = torch.stack([record(image, gains(0.0, None), noise, generator) for image in light])
    return torch.cat([read * (frames[..., 3:] > 0), frames[..., 3:]], -1)
