"""Deblurrer protocol: what every way of deblurring frames in the picture does.

A deblurrer is its parameters, the section `deblurrer` of `predeblur.<scene>`, with one method. A
new kind is a module with such a class and a line in `kinds.py` (docs/extending.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

MARGIN = 16  # pixels around the person in which anything is changed


@dataclass(frozen=True)
class Pictures:
    """Frames of one camera in the order of time, and how much of each pixel is the person."""

    frames: UInt8[Tensor, "F H W 3"]  # sRGB
    mattes: UInt8[Tensor, "F H W"]


@runtime_checkable
class Deblurrer(Protocol):
    """One way of making sharper frames of blurred ones."""

    @property
    def kind(self) -> str:
        """Its name in the registry."""
        ...

    def deblur(
        self, blurred: Pictures, averaging_space: str, clips: Sequence[slice]
    ) -> tuple[Pictures, dict[str, Any]]:
        """Sharpen frames and mattes, of which a soft one denies edges that the colours have.

        Args:
            blurred: what is given; it stays as it is.
            averaging_space: the space its light was averaged in, srgb or linear.
            clips: runs of frames that may be told of each other, and of no others.

        Returns:
            As many pictures of the same size, and what to note of how they were made.

        Raises:
            ArtifactError: if a file that it needs is missing or damaged.
        """
        ...


def person_box(matte: UInt8[Tensor, "H W"]) -> tuple[slice, slice] | None:
    """Rows and columns of the person with a margin; None where nobody is seen."""
    rows, columns = torch.nonzero(matte > 0, as_tuple=True)
    if len(rows) == 0:
        return None
    top, left = max(int(rows.min()) - MARGIN, 0), max(int(columns.min()) - MARGIN, 0)
    return slice(top, int(rows.max()) + MARGIN + 1), slice(left, int(columns.max()) + MARGIN + 1)


def values_of(codes: UInt8[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Values in [0, 1] of 8-bit codes."""
    return codes.float() / 255


def codes_of(values: Float[Tensor, "*shape"]) -> UInt8[Tensor, "*shape"]:
    """The nearest 8-bit codes of values in [0, 1]."""
    return (values * 255).round().to(torch.uint8)
