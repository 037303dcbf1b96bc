"""Deconvolution of each frame by itself, told by the matte (imaging/deconvolution.py)."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import torch
from jaxtyping import UInt8
from pydantic import Field
from torch import Tensor

from deblur_avatar.config.section import Count, Fraction, Params, Positive
from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear
from deblur_avatar.imaging.deblurring.deblurrer import (
    Pictures,
    codes_of,
    person_box,
    values_of,
)
from deblur_avatar.imaging.deconvolution import deblur_by_matte


class MatteParams(Params):
    """Straight streaks, of which each pixel takes the one that leaves the matte clearest."""

    kind: Literal["matte"]
    lengths: Annotated[tuple[Positive, ...], Field(min_length=1)]  # of the line PSFs tried, pixels
    angles: Count  # directions tried
    regularisation: Positive  # weight of smoothness against closeness
    window_sigma: Positive  # pixels, of the Gaussian window in which the matte is judged
    gain: Fraction  # by which the matte must become clearer

    def deblur(
        self, blurred: Pictures, averaging_space: str, clips: Sequence[slice]
    ) -> tuple[Pictures, dict[str, Any]]:
        """Put colours and mattes through the same filters; notes the mean length of streaks."""
        frames, mattes = blurred.frames.clone(), blurred.mattes.clone()
        lengths = []
        for index in range(len(frames)):
            box = person_box(blurred.mattes[index])
            if box is not None:
                made = self._sharpened(frames[index][box], mattes[index][box], averaging_space)
                frames[index][box], mattes[index][box], length = made
                lengths.append(length)
        mean = sum(lengths) / len(lengths) if lengths else None
        return Pictures(frames, mattes), {"streak_px": mean}

    def _sharpened(
        self, frame: UInt8[Tensor, "H W 3"], matte: UInt8[Tensor, "H W"], averaging_space: str
    ) -> tuple[UInt8[Tensor, "H W 3"], UInt8[Tensor, "H W"], float]:
        """One frame's box, and how long its PSFs are where the person is, pixels."""
        colors = values_of(frame)
        colors = srgb_to_linear(colors) if averaging_space == "linear" else colors
        coverage = values_of(matte)
        layers, lengths = deblur_by_matte(
            torch.cat([colors.permute(2, 0, 1), coverage[None]]),
            self.lengths, self.angles,
            regularisation=self.regularisation, window_sigma=self.window_sigma, gain=self.gain,
        )  # fmt: skip
        colors = layers[:3].permute(1, 2, 0)
        colors = linear_to_srgb(colors) if averaging_space == "linear" else colors
        mean = float((lengths * coverage).sum() / coverage.sum())
        return codes_of(colors), codes_of(layers[3]), mean
