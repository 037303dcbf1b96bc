"""Motion blur: a blurred frame is the mean of the sharp instants of its exposure.

Conventions. `factor` sub-frames lie between one frame and the next, at equal distances; frame j is
sub-frame `factor * j`. A blurred frame is the mean of `window` sub-frames (odd) centred on a frame,
in linear light (as a sensor adds it) or in sRGB values (as the paper and many data sets do). Each
sub-frame stands for one `1 / (factor * fps)` of a second, so the shutter is open for
`window / (factor * fps)`. Mattes are coverage: they are averaged as they are in either light.
"""

import math
from collections import deque
from collections.abc import Iterable, Iterator
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear

AveragingSpace = Literal["srgb", "linear"]

GUESS_STD = math.log(2)  # of the logarithm of an exposure that is guessed: to a factor of two


def expose(
    images: Float[Tensor, " S *image"], averaging_space: AveragingSpace
) -> Float[Tensor, "*image"]:
    """Average the sharp pictures of one exposure, differentiably.

    Args:
        images: sRGB in [0, 1].
        averaging_space: the space the mean is taken in.

    Returns:
        The blurred picture, sRGB in [0, 1].
    """
    if averaging_space == "srgb":
        return mean_of_instants(images)
    return linear_to_srgb(mean_of_instants(srgb_to_linear(images)))


def mean_of_instants(images: Float[Tensor, " S *image"]) -> Float[Tensor, "*image"]:
    """The whole model of blur: what a sensor gathers is the mean over the exposure's instants.

    Images are in the space in which light is averaged; coverage is averaged alike. Renders that
    the rasterizer has averaged already (`average=True`, the fused twin) are one instant here.
    """
    return images.squeeze(0) if len(images) == 1 else images.mean(0)


def with_instant(
    mean: Float[Tensor, "*image"], instants: int, image: Float[Tensor, "*image"]
) -> Float[Tensor, "*image"]:
    """The mean of so many instants and of one more."""
    return torch.lerp(mean, image, 1 / (instants + 1))


def encode(
    image: Float[Tensor, "*image"], averaging_space: AveragingSpace | str
) -> Float[Tensor, "*image"]:
    """Turn averaged light into sRGB values in [0, 1]."""
    return linear_to_srgb(image.clamp(0, 1)) if averaging_space == "linear" else image.clamp(0, 1)


def decode(
    image: Float[Tensor, "*image"], averaging_space: AveragingSpace | str
) -> Float[Tensor, "*image"]:
    """Turn sRGB values in [0, 1] into light of the space in which it is averaged."""
    return srgb_to_linear(image) if averaging_space == "linear" else image


def over(
    image: Float[Tensor, "H W 3"], alpha: Float[Tensor, "H W"], background: Float[Tensor, "H W 3"]
) -> Float[Tensor, "H W 3"]:
    """Composite over a background: the light that coverage lets through is added.

    All in the space in which light is averaged, where the mean of composites is the composite of
    means: of a background that stands still, an exposure's mean image and mean alpha are enough.

    Args:
        image: on black, premultiplied.
        alpha: coverage.
        background: what is behind.
    """
    return image + (1 - alpha)[..., None] * background


def exposure_seconds(window: int, factor: int, fps: float) -> float:
    """How long the shutter is open when `window` sub-frames are averaged."""
    return window / (factor * fps)


def frames_with_whole_window(count: int, factor: int, window: int) -> range:
    """Which of `count` frames have all their sub-frames inside the clip.

    Raises:
        ValueError: for a window that is even, and so has no middle.
    """
    if window % 2 == 0:
        raise ValueError(f"a window centred on a frame is odd, got {window}")
    reach = -(-(window // 2) // factor)  # frames on either side, rounded up
    return range(reach, count - reach)


def frames_before(
    timestamps: Float[Tensor, " F"], exposure: float | None, end: float
) -> tuple[int, ...]:
    """Which frames saw nothing of time `end` or later: their shutter had closed before.

    So a frame kept for training does not integrate over the part of a clip kept from it.

    Args:
        timestamps: the middle of each exposure, seconds.
        exposure: seconds the shutter is open; None counts as an instant.
        end: seconds.
    """
    closed = timestamps.double() + (exposure or 0.0) / 2
    return tuple(torch.nonzero(closed < end).flatten().tolist())


def blur_windows(
    subframes: Iterable[UInt8[np.ndarray, "H W D"]],
    count: int,
    factor: int,
    window: int,
    averaging_space: AveragingSpace,
) -> Iterator[UInt8[np.ndarray, "H W D"]]:
    """Average windows of sub-frames as they come, in the order of `frames_with_whole_window`.

    At most `window / factor + 2` running sums are in memory, however long the clip is.

    Args:
        subframes: all `factor * (count - 1) + 1` of them in order; three channels of sRGB, and
            further ones (mattes) that are averaged as they are.
        count: frames of the clip.
        factor: sub-frames a frame.
        window: sub-frames averaged, odd.
        averaging_space: the space the mean of the first three channels is taken in.
    """
    half = window // 2
    frames = frames_with_whole_window(count, factor, window)
    opening = {frame * factor - half for frame in frames}
    closing = {frame * factor + half for frame in frames}
    # A window is the difference of two running totals; float64 keeps that exact to 1e-9 of a code.
    open_totals: deque[Float[np.ndarray, "H W D"]] = deque()
    total: Float[np.ndarray, "H W D"] | None = None
    for index, subframe in enumerate(subframes):
        if total is None:
            total = np.zeros(subframe.shape, np.float64)
        if index in opening:
            open_totals.append(total.copy())
        total += _codes_to_light(subframe, averaging_space)
        if index in closing:
            yield _light_to_codes((total - open_totals.popleft()) / window, averaging_space)


_LINEAR_OF_CODE = srgb_to_linear(torch.arange(256, dtype=torch.float64) / 255).numpy()


def _codes_to_light(
    image: UInt8[np.ndarray, "H W D"], averaging_space: AveragingSpace
) -> UInt8[np.ndarray, "H W D"] | Float[np.ndarray, "H W D"]:
    if averaging_space == "srgb":
        return image
    return np.concatenate([_LINEAR_OF_CODE[image[..., :3]], image[..., 3:]], axis=-1)


def _light_to_codes(
    mean: Float[np.ndarray, "H W D"], averaging_space: AveragingSpace
) -> UInt8[np.ndarray, "H W D"]:
    if averaging_space == "linear":
        mean[..., :3] = linear_to_srgb(torch.from_numpy(mean[..., :3])).numpy() * 255
    return np.rint(mean).clip(0, 255).astype(np.uint8)
