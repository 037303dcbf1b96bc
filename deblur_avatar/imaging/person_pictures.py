"""Pictures of a person as fitting sees them: before what is known to be behind her, or on black.

Made some frames at a time: what is behind a moving camera's frames is as large as they are.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from deblur_avatar.imaging.backgrounds import Background
from deblur_avatar.imaging.exposure import AveragingSpace
from deblur_avatar.imaging.matting import (
    Plate,
    comparable_pixels,
    in_parts,
    lift_person,
    scenery,
)

Cut = Callable[[Tensor], Tensor]  # crops and scales pictures or mattes, all of them alike


class PersonPictures(NamedTuple):
    """Those fields of observations that are pictures of the training camera."""

    frames: UInt8[Tensor, "F H W 3"]
    mattes: UInt8[Tensor, "F H W"]
    comparable: UInt8[Tensor, "F H W"] | None
    backgrounds: UInt8[Tensor, "B H W 3"] | None


def person_pictures(
    frames: UInt8[Tensor, "F h w 3"],
    mattes: UInt8[Tensor, "F h w"],
    background: Background,
    cut: Cut,
    averaging_space: AveragingSpace,
) -> PersonPictures:
    """The person in front of what is known to be behind her, or on black.

    Args:
        frames: of one camera.
        mattes: of the person.
        background: behind her.
        cut: crops and scales.
        averaging_space: in which light adds up.
    """
    small = cut(mattes)
    if background.plates is None:
        return PersonPictures(cut(frames), small, None, None)
    if background.kind == "matte":
        shown = small.new_empty(*small.shape, 3)
        for part in in_parts(len(frames)):
            plates = background.plates[part]
            shown[part] = cut(lift_person(frames[part], mattes[part], plates, averaging_space))
        nowhere = torch.zeros_like(small, dtype=torch.bool)
        return PersonPictures(shown, small, comparable_pixels(small, nowhere), None)
    return _before_plates(frames, small, background.plates, background.one, cut)


def _before_plates(
    frames: UInt8[Tensor, "F h w 3"],
    small: UInt8[Tensor, "F H W"],
    plates: Sequence[Plate],
    one: Plate | None,
    cut: Cut,
) -> PersonPictures:
    shown, comparable = small.new_empty(*small.shape, 3), torch.empty_like(small)
    everywhere = None if one is None else _cut_plates([one], cut)
    behind = torch.empty_like(shown) if everywhere is None else everywhere[0]
    for part in in_parts(len(frames)):
        there, known = everywhere or _cut_plates(plates[part], cut)
        shown[part], comparable[part] = scenery(cut(frames[part]), small[part], there, known)
        if everywhere is None:
            behind[part] = there
    return PersonPictures(shown, small, None if bool(comparable.all()) else comparable, behind)


def _cut_plates(
    plates: Sequence[Plate], cut: Cut
) -> tuple[UInt8[Tensor, "B H W 3"], Bool[Tensor, "B H W"]]:
    """Pictures of plates, cut as frames are, and where they are known: wholly, or not."""
    pictures = torch.cat([cut(plate.picture[None]) for plate in plates])
    known = torch.cat([cut(plate.known[None].to(torch.uint8) * 255) == 255 for plate in plates])
    return pictures, known
