"""Background models: what is behind the person, for each kind of camera.

`none`: frames show the person on black already. `median`: one plate of a camera that stands still,
in each frame's light. `aligned`: a plate a frame, of a camera that drifts, turns or zooms. `matte`:
no plate; a pixel is what its matte says. `auto` takes the first of median, aligned and matte that
the frames allow.
"""

import logging
from collections.abc import Sequence
from typing import Literal, NamedTuple, overload

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from deblur_avatar.imaging.aligned_plates import aligned_plates, believed
from deblur_avatar.imaging.background_features import FrameFeatures
from deblur_avatar.imaging.camera_motion import STILL, background_travel
from deblur_avatar.imaging.matting import Plate, background_plate, no_plate
from deblur_avatar.imaging.plate_light import EvenPlates, even_plates
from deblur_avatar.run import in_threads

logger = logging.getLogger(__name__)

BackgroundKind = Literal["none", "median", "aligned", "matte", "auto"]
KNOWN_SHARE = 0.3  # of the band around the person that aligned plates must know to be worth having


class Background(NamedTuple):
    """What is known of the background of one camera's frames."""

    kind: BackgroundKind
    plates: Sequence[Plate] | None  # one a frame; None where frames show the person on black
    one: Plate | None  # that lies behind all frames, where they do not differ
    light: Float[Tensor, "F 3"] | None  # stops of frames' light from all others', where it changes


class _LitPlates(Sequence[Plate]):
    """One plate in each frame's light, known where it agrees with the frame.

    Made when it is asked for: all of them are as large as the clip.
    """

    def __init__(
        self, frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"], even: EvenPlates
    ) -> None:
        self._frames, self._mattes, self._even = frames, mattes, even

    def __len__(self) -> int:
        return len(self._frames)

    @overload
    def __getitem__(self, index: int) -> Plate: ...

    @overload
    def __getitem__(self, index: slice) -> list[Plate]: ...

    def __getitem__(self, index: int | slice) -> Plate | list[Plate]:
        if isinstance(index, slice):
            return in_threads(self.__getitem__, range(len(self))[index])
        return believed(self._frames[index], self._mattes[index], self._even.lit(index))


class BackgroundEstimator:
    """Estimates what is behind the person in one camera's frames, for any mattes of hers."""

    def __init__(self, frames: UInt8[Tensor, "F H W 3"]) -> None:
        self._frames = frames
        self._features = FrameFeatures(frames)

    def background(self, kind: BackgroundKind, mattes: UInt8[Tensor, "F H W"]) -> Background:
        """The background of the frames; `auto` is settled by what they show."""
        if kind == "none":
            return Background(kind, None, None, None)
        if kind == "auto":
            travel = background_travel(self._frames, mattes)
            if travel is not None and travel < STILL:
                logger.info("the camera stands still: one background for all frames")
                kind = "median"
            else:
                kind = "aligned"
        if kind == "median":
            return _still(self._frames, mattes)
        if kind == "aligned":
            aligned = aligned_plates(self._frames, mattes, self._features)
            share = 0.0 if aligned is None else _known_share(aligned[0], mattes)
            if aligned is not None and share >= KNOWN_SHARE:
                logger.info(
                    "the camera moves: aligned frames show %.0f %% of the background around the "
                    "person",
                    100 * share,
                )
                return Background("aligned", aligned[0], None, aligned[1])
            logger.warning(
                "the background cannot be measured (aligned frames show %.0f %% of it around the "
                "person): pixels are taken as the mattes say, and edges of mattes are not compared",
                100 * share,
            )
        return _same("matte", no_plate(mattes[0]), len(mattes))


def _same(kind: BackgroundKind, plate: Plate, count: int) -> Background:
    return Background(kind, [plate] * count, plate, None)


def _still(frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"]) -> Background:
    """One plate, or one a frame where the light changes."""

    def one_plate(frames: UInt8[Tensor, "F H W 3"]) -> list[Plate]:
        return [background_plate(frames, mattes)] * len(frames)

    even = even_plates(frames, mattes, one_plate)
    if even.stops is None:
        return _same("median", even.plates[0], len(frames))
    return Background("median", _LitPlates(frames, mattes, even), None, even.stops)


def matte_edge(matte: UInt8[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    """Where a matte goes over from the person to the background.

    Its soft pixels, and both sides of wherever it jumps from nothing to full: a mask of 0 and 255
    has no soft ones, while a matte that is soft all around has no jumps, so that its edge is its
    soft pixels and no more.
    """
    alpha, around = matte.numpy(), np.ones((3, 3), np.uint8)
    none, full = (alpha == 0).astype(np.uint8), (alpha == 255).astype(np.uint8)
    jump = none & cv2.dilate(full, around) | full & cv2.dilate(none, around)
    return torch.from_numpy((jump > 0) | (alpha > 0) & (alpha < 255))


def _known_share(plates: list[Plate], mattes: UInt8[Tensor, "F H W"]) -> float:
    """Share of the edges of mattes whose background is known."""
    edges = in_threads(matte_edge, mattes)
    known = sum(int(plate.known[edge].sum()) for plate, edge in zip(plates, edges, strict=True))
    return known / max(sum(int(edge.sum()) for edge in edges), 1)
