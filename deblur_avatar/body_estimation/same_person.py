"""Same person: whether sightings are of one, by place, size and the colours of what she wears.

A detector that follows one person goes over to another who comes near, or whom it sees better, and
says nothing. Then landmarks jump and colours change, both at once: who moves fast keeps hers, and
who turns round or walks into a shadow does not jump. Sizes here are the longer side of the box
around a person's landmarks.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.body_estimation.landmarks import Landmarks, Sighting, landmarks_of

SURE = 0.5  # visibility from which a landmark is believed, or a person by the median of hers
FEW = 5  # landmarks that are believed: fewer, and all are
REACH, DRIFT = 0.6, 0.1  # her sizes that she moves in a frame at most, and more for each one missed
RESIZED = 2.5  # times as large or as small as when she was last seen, at most
JUMP = 0.12  # her sizes: hardly anybody moves a quarter of her landmarks farther in a frame
NEARER = 2.0  # CIELAB's difference by which colours are one person's and not the other's
UNLIKE = 10.0  # CIELAB's difference of colours from which they are somebody else's
PATCH = 0.09  # her sizes, half the side of the squares whose colours are taken
TOO_SMALL = 100  # pixels: of who is smaller, colours are of what is beside her, too
SHOULDERS, HIPS, KNEES = [11, 12], [23, 24], [25, 26]  # MediaPipe's landmarks
CHEST, BELLY, THIGH = 0.25, 0.6, 0.4  # of the way from shoulders to hips and from hip to knee
COMPARED = 2  # places of four in which both were seen, at least
RUN = 5  # frames in a row that agree: a person, and no mistake


@dataclass(frozen=True)
class Look:
    """Where a person is in one frame, how large, and in which colours."""

    sighting: Sighting
    sureness: float  # the median landmark's visibility: half of a person may be hidden
    centre: Float[Tensor, " 2"]  # pixels
    size: float  # pixels
    colors: Float[Tensor, "4 3"]  # CIELAB, of chest, belly and thighs; NaN where not seen

    @classmethod
    def of(cls, sighting: Sighting, frame: UInt8[Tensor, "H W 3"]) -> "Look":
        """The look of who was sighted in a frame."""
        sure = sighting.visibility >= SURE
        points = sighting.points[sure] if sure.sum() >= FEW else sighting.points
        low, high = points.amin(0), points.amax(0)
        size = float((high - low).max())
        sureness = float(sighting.visibility.median())
        return cls(sighting, sureness, (low + high) / 2, size, _colors(sighting, frame, size))

    @property
    def is_sure(self) -> bool:
        """Whether it is believed that this is a person."""
        return self.sureness >= SURE

    def is_near(self, other: "Look", missed: int) -> bool:
        """Whether who was last seen here may be there, after so many frames without her."""
        way = float((self.centre - other.centre).norm())
        larger, smaller = max(self.size, other.size), min(self.size, other.size)
        return way <= (REACH + DRIFT * missed) * self.size and larger <= RESIZED * smaller

    def jumps_to(self, other: "Look", frames: int) -> bool:
        """Whether landmarks move farther in so many frames than people do."""
        here, there = self.sighting, other.sighting
        sure = (here.visibility >= SURE) & (there.visibility >= SURE)
        ways = (here.points - there.points).norm(dim=1)
        way = (ways[sure] if sure.sum() >= FEW else ways).quantile(0.75)
        return float(way) > frames * JUMP * max(self.size, other.size)

    def is_unlike(self, known: Iterable["Look"]) -> bool:
        """Whether colours are none that she was surely seen in: most places differ from all."""
        return self.difference(colors_worn(known)) > UNLIKE

    def is_rather(self, hers: Sequence["Look"], others: Sequence["Look"]) -> bool:
        """Whether colours are hers and not those of others; not, where they do not compare."""
        from_others = self.difference(colors_worn(others))
        return from_others - self.difference(colors_worn(hers)) >= NEARER

    def difference(self, worn: Float[Tensor, "K 4 3"]) -> float:
        """Of colours from the most alike that were worn: CIELAB's, of the median place. NaN where
        too few places compare.
        """
        apart = (worn - self.colors).norm(dim=2)
        compared = apart[(~apart.isnan()).sum(1) >= COMPARED]
        return float(compared.nanmedian(1).values.min()) if len(compared) else math.nan


Looks = Sequence[Look | None]  # of a track, frame after frame


def colors_worn(known: Iterable[Look]) -> Float[Tensor, "K 4 3"]:
    """Colours in which somebody was surely seen."""
    found = [look.colors for look in known if look.is_sure]
    return torch.stack(found) if found else torch.empty(0, 4, 3)


def looks_of(person: Landmarks, frames: UInt8[Tensor, "F H W 3"]) -> list[Look | None]:
    """A track's look in each frame; None where nobody was found."""
    if person.world is None:
        return [None] * len(frames)
    sightings = map(Sighting, person.points, person.visibility, person.world, person.mattes)
    return [
        Look.of(sighting, frame) if found else None
        for found, sighting, frame in zip(person.found, sightings, frames, strict=True)
    ]


def track_of(seen: Mapping[int, Look], track: Landmarks) -> Landmarks:
    """A person as she was seen in some frames of those that a track is of."""
    count, height, width = track.mattes.shape
    sightings = (seen[index].sighting if index in seen else None for index in range(count))
    return landmarks_of(sightings, (count, height, width), track.model)


def is_same(look: Look, known: Sequence[Look], missed: int) -> bool:
    """Whether a look is of whom these are, the last of them so many frames ago and more."""
    return known[-1].is_near(look, missed) and not is_another(look, known)


def is_another(look: Look, known: Sequence[Look]) -> bool:
    """Whether a look is of somebody else than these: in other clothes, after a jump."""
    return known[-1].jumps_to(look, 1) and look.is_unlike(known)


def is_one(looks: Iterable[Look | None]) -> bool:
    """Whether a track is one person's, as far as who is surely seen in it tells."""
    known: list[Look] = []
    for look in looks:
        if look is None or not look.is_sure:
            continue
        if known and is_another(look, known):
            return False
        known.append(look)
    return True


def _colors(sighting: Sighting, frame: UInt8[Tensor, "H W 3"], size: float) -> Float[Tensor, "4 3"]:
    points, sure = sighting.points, sighting.visibility >= SURE
    shoulders, hips = points[SHOULDERS].mean(0), points[HIPS].mean(0)
    places = [shoulders.lerp(hips, CHEST), shoulders.lerp(hips, BELLY)]
    places += list(points[HIPS].lerp(points[KNEES], THIGH))
    trunk, thighs = sure[SHOULDERS + HIPS].all(), sure[HIPS] & sure[KNEES]
    seen = torch.stack([trunk, trunk, *thighs]) & (size >= TOO_SMALL)
    codes = torch.stack([_mean_color(frame, place, PATCH * size) for place in places])
    lab = cv2.cvtColor(codes.numpy()[None].astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    return torch.where(codes.isnan() | ~seen[:, None], torch.nan, torch.from_numpy(lab[0]))


def _mean_color(
    frame: UInt8[Tensor, "H W 3"], place: Float[Tensor, " 2"], half: float
) -> Float[Tensor, " 3"]:
    """Mean of a square, sRGB codes, so that stripes do not count; NaN where it lies outside."""
    height, width = frame.shape[:2]
    (left, top), (right, bottom) = (place - half).floor().tolist(), (place + half + 1).tolist()
    rows = slice(max(int(top), 0), max(min(int(bottom), height), 0))
    columns = slice(max(int(left), 0), max(min(int(right), width), 0))
    return frame[rows, columns].reshape(-1, 3).float().mean(0)  # of nothing it is NaN
