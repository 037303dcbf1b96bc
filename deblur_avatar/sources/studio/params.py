"""Parameters of the synthetic studio."""

from typing import Annotated, Literal

from pydantic import Field

from deblur_avatar.config.section import (
    Count,
    Fraction,
    NonNegative,
    Params,
    Positive,
)


class StudioParams(Params):
    """A synthetic person with exact truth.

    `motion` names a motion of `sources/studio`; `window` sub-frames (480 a second) are averaged
    into the true blur. Pose noise is correlated over `noise_correlation_s`.
    """

    source: Literal["studio"]
    motion: str
    frames: Annotated[int, Field(ge=2)]
    fps: Positive
    image_size: Annotated[int, Field(ge=8)]  # square, pixels
    test_cameras: Count
    test_stride: Count
    window: Count
    samples_per_axis: Count  # rays a pixel is (samples_per_axis)^2
    noise_degrees: NonNegative  # root mean square of each joint's angle of error
    noise_mm: NonNegative  # root mean square of the root's distance from its place
    noise_correlation_s: NonNegative
    held_out: Fraction  # last part of the clip, kept from training
