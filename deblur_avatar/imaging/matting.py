"""Matting: a person in front of a background that is known, or lifted off it onto black.

Conventions. A picture is the person's light plus (1 - alpha) times the background's light, where
alpha is the matte (coverage). `averaging_space` says in which space light adds up: `linear`, or
sRGB values (as averaged by the paper). Pictures and mattes are 8 bits.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.imaging.exposure import AveragingSpace, decode, encode
from deblur_avatar.run import in_threads

BARE = 26  # matte, of 255: below it (10 %) a pixel is taken to show the background
FULL = 230  # from it on (90 %) a pixel is taken to show nothing but the person
BAND = 0.006  # of the picture's height: half the width of a mask's edge that is not to be trusted
ENOUGH = 3  # frames that must show a pixel's background for it to be trusted
NEAR = 0.015  # of the picture's height: so far from a mask the person may still be in the picture
GLANCES = 5  # frames that tell the background where nobody ever is
NOISE, DISTINCT = 8.0, 24.0  # codes from the plate: surely the background, surely something else
AT_ONCE = 2**21  # pixels of all frames that are sorted at once; changes no result
FRAMES_AT_ONCE = 32  # whose plates are made at once; changes no result
NEIGHBOURHOOD = 5  # pixels over which a difference is averaged; leaks narrower than it stay shut


class Plate(NamedTuple):
    """What a still camera sees behind the person."""

    picture: UInt8[Tensor, "H W 3"]  # 0 where not known
    known: Bool[Tensor, "H W"]


def background_plate(frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"]) -> Plate:
    """Estimate the background: the (lower) median of the frames that are bare of the person.

    It is known where at least `ENOUGH` frames are bare. Far from the person's path a few frames are
    enough to tell it.
    """
    path = near_person(mattes.amax(0)[None] > 0)[0]
    counted = torch.zeros_like(path, dtype=torch.int32)
    for matte in mattes:  # all at once are as many bytes as the mattes
        counted += matte < BARE
    known = ~path | (counted >= ENOUGH)
    some = evenly_spaced(range(len(frames)), GLANCES)
    picture = frames[some].sort(dim=0).values[(len(some) - 1) // 2]
    picture[path] = 0
    wanted = (path & known).flatten().nonzero()[:, 0]
    pixels, alphas = frames.flatten(1, 2), mattes.flatten(1)
    parts = wanted.split(max(1, AT_ONCE // len(frames)))
    medians = in_threads(lambda part: _lower_median(pixels[:, part], alphas[:, part] < BARE), parts)
    picture.view(-1, 3)[wanted] = torch.cat(medians)
    return Plate(picture, known)


def _lower_median(
    values: UInt8[Tensor, "F P 3"], counts: Bool[Tensor, "F P"]
) -> UInt8[Tensor, "P 3"]:
    """Of those values that count, one at least: their median, the lower of two."""
    # Sorted behind all others, what does not count does not move the median of the rest.
    columns = torch.where(counts[..., None], values, 255).permute(1, 2, 0).contiguous().numpy()
    columns.sort(axis=2, kind="stable")  # by radix, which is made for bytes
    middle = (counts.sum(0).numpy() - 1) // 2
    found = np.take_along_axis(columns, middle[:, None, None].repeat(3, axis=1), axis=2)
    return torch.from_numpy(found[..., 0])


def near_person(masks: Bool[Tensor, "F H W"]) -> Bool[Tensor, "F H W"]:
    """Masks, and as far around them as the person may be in the picture unseen by a segmenter."""
    return _dilated(masks, round(NEAR * masks.shape[1]))


def _dilated(masks: Bool[Tensor, "F H W"], radius: int) -> Bool[Tensor, "F H W"]:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    dilated = [cv2.dilate(mask, kernel) for mask in masks.to(torch.uint8).numpy()]
    return torch.from_numpy(np.stack(dilated)).bool()


def trim_mattes(
    frames: UInt8[Tensor, "F H W 3"],
    mattes: UInt8[Tensor, "F H W"],
    plates: Sequence[Plate],
    untold: Callable[[int, Plate], Bool[np.ndarray, "H W"]] | None = None,
) -> UInt8[Tensor, "F H W"]:
    """Take those parts off mattes where a picture shows just the background.

    Segmentation spills over the outline. What looks like the plate is trimmed if it is joined to
    the outside: inside the person it is clothing of the background's colour.

    Args:
        frames: of one camera.
        mattes: of the person.
        plates: one a frame.
        untold: where the plate of a frame, by its number, looks like the person herself, so that
            the picture tells nothing and nothing is trimmed.
    """

    def trimmed(index: int, plate: Plate) -> UInt8[Tensor, "H W"]:
        alike = None if untold is None else untold(index, plate)
        return _trimmed(frames[index], mattes[index], plate, alike)

    alone = torch.empty_like(mattes)
    for part in in_parts(len(frames)):
        alone[part] = torch.stack(in_threads(trimmed, range(len(frames))[part], plates[part]))
    return alone


def in_parts(count: int) -> list[slice]:
    """Frames in a row, so many that plates of them all take little memory."""
    return [slice(first, first + FRAMES_AT_ONCE) for first in range(0, count, FRAMES_AT_ONCE)]


def _trimmed(
    frame: UInt8[Tensor, "H W 3"],
    matte: UInt8[Tensor, "H W"],
    plate: Plate,
    alike: Bool[np.ndarray, "H W"] | None,
) -> UInt8[Tensor, "H W"]:
    alpha = matte.numpy()
    known, weight = plate.known.numpy(), plate.known.float().numpy()
    around = (NEIGHBOURHOOD, NEIGHBOURHOOD)
    red, green, blue = np.moveaxis(cv2.absdiff(frame.numpy(), plate.picture.numpy()), -1, 0)
    difference = np.maximum(np.maximum(red, green), blue) * weight
    difference = cv2.blur(difference, around) / cv2.blur(weight, around).clip(1e-3)
    share = ((difference - NOISE) / (DISTINCT - NOISE)).clip(0, 1)
    share[~known] = 1
    if alike is not None:
        share[alike] = 1
    bare = ((share < 0.5) | (alpha < BARE)).astype(np.uint8)
    bare = cv2.morphologyEx(bare, cv2.MORPH_OPEN, np.ones(around, np.uint8))
    _, pieces = cv2.connectedComponents(cv2.copyMakeBorder(bare, 1, 1, 1, 1, 0, value=1))
    outside = pieces[1:-1, 1:-1] == pieces[0, 0]
    return torch.from_numpy(np.where(outside, np.rint(alpha * share), alpha).astype(np.uint8))


def lift_person(
    frames: UInt8[Tensor, "F H W 3"],
    mattes: UInt8[Tensor, "F H W"],
    plates: Sequence[Plate],
    averaging_space: AveragingSpace,
) -> UInt8[Tensor, "F H W 3"]:
    """Take the background's share away: pictures of the person on black.

    The rest is clamped to what coverage `alpha` can emit, [0, alpha]. Where the plate is not known
    the background is taken to have the pixel's own colour, which multiplies it by alpha.
    """
    return torch.stack(
        in_threads(
            lambda frame, matte, plate: _lift(frame, matte, plate, averaging_space),
            *(frames, mattes, plates),
        )
    )


class Scenery(NamedTuple):
    """Frames of a person in front of plates, ready to be compared with renders in front of them."""

    frames: UInt8[Tensor, "F H W 3"]  # as filmed near the person, elsewhere the plates themselves
    comparable: UInt8[Tensor, "F H W"]  # 255 where colours mean something


def scenery(
    frames: UInt8[Tensor, "F H W 3"],
    mattes: UInt8[Tensor, "F H W"],
    pictures: UInt8[Tensor, "B H W 3"],
    known: Bool[Tensor, "B H W"],
) -> Scenery:
    """Keep the background where it is known, so that no matte decides whose light a pixel is.

    Away from the person nothing but the background is left: not her shadow, not a passer-by.
    Where the plate is not known, a frame stays as it was filmed inside of her, and is black beside
    her.

    Args:
        frames: of one camera.
        mattes: of the person; soft edges and blurred limbs need not be right.
        pictures: plates, one for all frames or one each; black where not known.
        known: where.
    """
    near = near_person(mattes > 0) & (known | (mattes > 0))
    shown = torch.where(near[..., None], frames, pictures)
    return Scenery(shown, comparable_pixels(mattes, known.expand_as(near)))


def no_plate(matte: UInt8[Tensor, "H W"]) -> Plate:
    """The plate of a frame whose background is known nowhere."""
    return Plate(matte.new_zeros(*matte.shape, 3), torch.zeros_like(matte, dtype=torch.bool))


def comparable_pixels(
    mattes: UInt8[Tensor, "F H W"], known: Bool[Tensor, "F H W"]
) -> UInt8[Tensor, "F H W"]:
    """Where colours can be compared: 255, elsewhere 0.

    That is inside the person, outside of her, and in the band between where the background is
    known. Elsewhere in the band nobody knows how much of a pixel's light is the background's.
    """
    radius = max(1, round(BAND * mattes.shape[1]))
    inside = ~_dilated(mattes < FULL, radius)
    outside = ~_dilated(mattes >= BARE, radius)
    return (inside | outside | known).to(torch.uint8) * 255


def _lift(
    frame: UInt8[Tensor, "H W 3"],
    matte: UInt8[Tensor, "H W"],
    plate: Plate,
    averaging_space: AveragingSpace,
) -> UInt8[Tensor, "H W 3"]:
    touched = matte > 0
    alpha = (matte[touched].float() / 255)[:, None]
    seen = _to_light(frame[touched], averaging_space)
    hidden = _to_light(plate.picture[touched], averaging_space)
    hidden = torch.where(plate.known[touched][:, None], hidden, seen)
    person = (seen - (1 - alpha) * hidden).clamp(min=0).minimum(alpha)
    lifted = torch.zeros_like(frame)
    lifted[touched] = _from_light(person, averaging_space)
    return lifted


def _to_light(codes: UInt8[Tensor, "P 3"], averaging_space: AveragingSpace) -> Float[Tensor, "P 3"]:
    return decode(codes.float() / 255, averaging_space)


def _from_light(
    values: Float[Tensor, "P 3"], averaging_space: AveragingSpace
) -> UInt8[Tensor, "P 3"]:
    return (encode(values, averaging_space) * 255).round().to(torch.uint8)
