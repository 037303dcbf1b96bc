"""Own colours of limbs, and where a background has them: there a picture tells nothing of mattes.

Conventions. Tapered capsules are two ends, each with its radius: right, down, radius, in pixels
with the centre of the top left one at (0.5, 0.5). NaN where a limb is not known.
"""

from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from deblur_avatar.imaging.matting import Plate
from deblur_avatar.imaging.plate_light import relit
from deblur_avatar.run import in_threads

FEWEST, MOST = 100, 500  # pixels of a limb that tell its colour: of all frames, of each
ALIKE = 24  # codes: colours that differ less may be one in two lights
AROUND = 2.5  # times as wide as what is surely nothing but a limb, it and its clothes may be


class _Window(NamedTuple):
    """Part of a picture, and which of its pixels are in all of some capsules."""

    rows: slice
    columns: slice
    inside: Bool[np.ndarray, "h w"]


class LimbColors(NamedTuple):
    """Own colours of limbs, sRGB codes, and where limbs are."""

    colors: Float[Tensor, "B 3"]  # in the light that frames have in common; NaN where not known
    capsules: Float[Tensor, "F B T 6"]
    light: Float[Tensor, "F 3"] | None  # stops of each frame's from that; None where it is the same

    def shared_with(self, index: int, plate: Plate) -> Bool[np.ndarray, "H W"]:
        """Where a plate has the own colour of a limb that is there, clothes included.

        Args:
            index: of a frame: of where limbs are in the middle of its exposure, and of its light.
            plate: behind it, in that light.
        """
        picture = plate.picture.numpy()
        found = np.zeros(picture.shape[:2], np.bool_)
        known = self.colors.isfinite().all(1)
        limbs = self.capsules[index, known, self.capsules.shape[2] // 2]
        wide = limbs * torch.tensor([1, 1, AROUND, 1, 1, AROUND])
        colors = self.colors[known].round().to(torch.uint8)[None]
        colors = _in_light(colors, self.light, index)[0]
        for capsule, color in zip(wide, colors.numpy(), strict=True):
            window = _window(capsule[None], picture.shape[:2])
            if window is not None:
                cut = picture[window.rows, window.columns]
                apart = cv2.absdiff(cut, np.broadcast_to(color, cut.shape))
                found[window.rows, window.columns] |= window.inside & (apart.max(2) < ALIKE)
        return found


def own_colors(
    frames: UInt8[Tensor, "F H W 3"],
    capsules: Float[Tensor, "F B T 6"],
    light: Float[Tensor, "F 3"] | None,
) -> LimbColors:
    """Own colours of limbs: the median of the pixels that a limb covers at all instants.

    Args:
        frames: of one camera.
        capsules: no wider than limbs are, at T instants of each exposure, the middle one in its
            middle.
        light: as `LimbColors` has it.
    """
    away = None if light is None else -light

    def even(index: int) -> list[UInt8[np.ndarray, "P 3"]]:
        pixels = [torch.from_numpy(_covered(frames[index], limb))[None] for limb in capsules[index]]
        return [_in_light(limb, away, index)[0].numpy() for limb in pixels]

    colors = torch.full((capsules.shape[1], 3), torch.nan)
    for limb, seen in enumerate(zip(*in_threads(even, range(len(frames))), strict=True)):
        pixels = np.concatenate(seen)
        if len(pixels) >= FEWEST:
            colors[limb] = torch.from_numpy(np.median(pixels, axis=0))
    return LimbColors(colors, capsules, light)


def _in_light(
    codes: UInt8[Tensor, "1 P 3"], light: Float[Tensor, "F 3"] | None, index: int
) -> UInt8[Tensor, "1 P 3"]:
    """Colours in a frame's light."""
    return codes if light is None else relit(codes, light[index])


def _covered(
    frame: UInt8[Tensor, "H W 3"], capsules: Float[Tensor, "T 6"]
) -> UInt8[np.ndarray, "P 3"]:
    """Colours of pixels that all capsules cover, evenly few of many."""
    window = _window(capsules, frame.shape[:2])
    if window is None:
        return np.zeros((0, 3), np.uint8)
    pixels = frame.numpy()[window.rows, window.columns][window.inside]
    return pixels[:: max(1, len(pixels) // MOST)]


def _window(capsules: Float[Tensor, "T 6"], size: tuple[int, ...]) -> _Window | None:
    """The pixels that all capsules cover, none where one is not known or outside the picture."""
    if not bool(capsules.isfinite().all()):
        return None
    ends = capsules.view(-1, 2, 3).numpy()
    low = (ends[..., :2] - ends[..., 2:]).min(1).max(0)  # of each capsule's box, of all of them
    high = (ends[..., :2] + ends[..., 2:]).max(1).min(0)
    left, top = np.floor(low.clip(0)).astype(int).tolist()
    right, bottom = np.ceil(high.clip(0, (size[1], size[0]))).astype(int).tolist()
    if right <= left or bottom <= top:
        return None
    down, along = np.ogrid[top + 0.5 : bottom, left + 0.5 : right]
    inside = np.logical_and.reduce([_in_capsule(along, down, two) for two in ends])
    return _Window(slice(top, bottom), slice(left, right), inside)


def _in_capsule(
    right: Float[np.ndarray, "1 w"], down: Float[np.ndarray, "h 1"], ends: Float[np.ndarray, "2 3"]
) -> Bool[np.ndarray, "h w"]:
    """Which points are nearer to a place on the line between two ends than its radius there."""
    (x, y, radius), (x_step, y_step, r_step) = ends[0].tolist(), (ends[1] - ends[0]).tolist()
    x_way, y_way = right - x, down - y
    length = max(x_step**2 + y_step**2, 1e-6)
    share = ((x_way * x_step + y_way * y_step) / length).clip(0, 1)
    apart = np.hypot(x_way - share * x_step, y_way - share * y_step)
    return np.asarray(apart < radius + share * r_step)
