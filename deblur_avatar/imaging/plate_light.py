"""Light of background plates: frames that a camera's automatics made brighter or darker.

A plate is the median of frames. Where exposure or white balance is regulated, a cloud passes or the
sun is covered, that is the light of few of them, and what differs from it would be explained by the
person. So the light is taken out of frames first, and given back to each frame's plate.

Conventions. Stops are of linear light, one for each colour: a frame of 1 has twice its plate's.
"""

import logging
from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.imaging.camera_motion import background_mask
from deblur_avatar.imaging.color import linear_to_srgb, srgb_to_linear
from deblur_avatar.imaging.matting import Plate
from deblur_avatar.run import in_threads

logger = logging.getLogger(__name__)

STEADY = 0.25  # stops from its plate that no frame is: a middle grey is then 10 codes off
BRIGHT, DARK = 235, 24  # codes between which light is proportional enough to compare
ROWS = 180  # at which light is compared: a median needs no more pixels
FEWEST = 100  # pixels whose median means something


class EvenPlates(NamedTuple):
    """Plates in one light, and how much more of it each frame has."""

    plates: list[Plate]  # one a frame
    stops: Float[Tensor, "F 3"] | None  # None where the light hardly changes

    def lit(self, index: int) -> Plate:
        """A plate as bright as the frame it lies behind."""
        plate = self.plates[index]
        if self.stops is None:
            return plate
        return Plate(relit(plate.picture, self.stops[index]), plate.known)


def even_plates(
    frames: UInt8[Tensor, "F H W 3"],
    mattes: UInt8[Tensor, "F H W"],
    plates_of: Callable[[UInt8[Tensor, "F H W 3"]], list[Plate]],
) -> EvenPlates:
    """Plates from which the light that changes is taken out.

    Args:
        frames: of one camera.
        mattes: of the person.
        plates_of: estimates a plate for each of such frames.

    Returns:
        What `plates_of` says of the frames, unless some frame's light is `STEADY` or more from its
        plate's.
    """
    plates = plates_of(frames)
    stops = _stops_of(frames, mattes, plates)
    most = float(stops.abs().max())
    if most < STEADY:
        return EvenPlates(plates, None)
    logger.info("the light changes by up to %.1f stops: each frame's background follows it", most)
    even = torch.empty_like(frames)
    in_threads(lambda out, frame, less: out.copy_(relit(frame, less)), even, frames, -stops)
    plates = plates_of(even)
    del even  # as large as the clip
    return EvenPlates(plates, _stops_of(frames, mattes, plates))


def relit(picture: UInt8[Tensor, "H W 3"], stops: Float[Tensor, " 3"]) -> UInt8[Tensor, "H W 3"]:
    """A picture in so much more light; black stays black, and what was too bright to tell is."""
    codes = torch.arange(256.0) / 255
    light = srgb_to_linear(codes)[:, None] * 2.0**stops
    table = (linear_to_srgb(light) * 255).round().clamp(0, 255).to(torch.uint8)
    return table.gather(0, picture.reshape(-1, 3).long()).reshape(picture.shape)


def _stops_of(
    frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"], plates: Sequence[Plate]
) -> Float[Tensor, "F 3"]:
    return torch.stack(in_threads(_stops, frames, mattes, plates))


def _stops(
    frame: UInt8[Tensor, "H W 3"], matte: UInt8[Tensor, "H W"], plate: Plate
) -> Float[Tensor, " 3"]:
    """By how much the median pixel beside the person is brighter than the plate; 0: not known."""
    some = (slice(None, None, max(1, len(frame) // ROWS)),) * 2
    bare = background_mask(matte[some]) & plate.known[some]
    codes = torch.stack([frame[some][bare], plate.picture[some][bare]])
    told = ((codes > DARK) & (codes < BRIGHT)).all(0)
    light = srgb_to_linear(codes / 255).log2()
    change = light[0] - light[1]
    return torch.stack(
        [
            change[:, c][told[:, c]].median()
            if told[:, c].sum() >= FEWEST
            else change.new_zeros(())
            for c in range(3)
        ]
    )
