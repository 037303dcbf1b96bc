"""Parameters of the street scene: each way in which it looks like life, by itself or off."""

from typing import Annotated, Literal

from pydantic import Field

from deblur_avatar.config.section import Count, Params, Positive
from deblur_avatar.sources.studio.hand_held import HandHeldParams
from deblur_avatar.sources.studio.held_prop import HeldPropParams
from deblur_avatar.sources.studio.passer_by import PasserByParams
from deblur_avatar.sources.studio.sensor import DriftParams, NoiseParams, RollingShutterParams
from deblur_avatar.sources.studio.unfitted_body import UnfittedParams


class EncodingParams(Params):
    """H.264, by x264."""

    quality: Annotated[int, Field(ge=0, le=51)]  # constant rate factor; 18 is good, 28 a phone's


class FilmParams(Params):
    """What is filmed and how. Every option is a section of its own, or null: off."""

    seed: Annotated[int, Field(ge=0)]  # of the street, the camera's way, the noise
    motion: str  # of `sources/studio/motion.py`
    frames: Annotated[int, Field(ge=2)]
    fps: Positive
    shutter: Annotated[float, Field(gt=0, le=1)]  # exposure as a share of the frame interval
    instants: Count  # of an exposure, averaged
    size: tuple[Count, Count]  # width and height, pixels
    field_of_view: Annotated[float, Field(gt=5, lt=150)]  # degrees, longer side
    samples_per_axis: Count  # rays a pixel and instant are (samples_per_axis)^2
    unfitted_body: UnfittedParams | None
    backdrop: Literal["street"] | None  # null: black
    hand_held: HandHeldParams | None
    noise: NoiseParams | None
    encoding: EncodingParams | None  # null: without loss
    exposure_drift: DriftParams | None
    rolling_shutter: RollingShutterParams | None
    passer_by: PasserByParams | None
    held_prop: HeldPropParams | None
