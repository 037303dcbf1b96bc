"""Whom a track shows where others pass: before the tracks both ways are compared, and after.

    python -m benchmarks.passers_by [--frames 60] [--people 3] [--first 100] [--json FILE]

draws people who move on the spot in a street while others walk past, sharply, 640 pixels square: in
front of them, behind, near the camera, far off, in the same clothes, two of them, and nobody; and
with others who move on the spot beside them, in other clothes or in the same ones.
Prints JSON, a case at a time, shares of all frames: in which she is to be seen (a third of her
largest matte or more); in which the matte that was found covers her, somebody else, or parts of
both, in the detector's first track (`detect_with_mediapipe`) and in the one that is taken
(`detect_main_person`); and in what share of the films it was said that several were mixed up or may
be. Half an hour of one core for three people, 2 GB.
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from benchmarks.exercises import mean_of, print_measured
from benchmarks.hands_and_head import SHAPE
from deblur_avatar.artifacts.body import Body
from deblur_avatar.body_estimation import person_choice
from deblur_avatar.body_estimation.landmarks import Landmarks, detect_with_mediapipe
from deblur_avatar.body_estimation.person_choice import detect_main_person
from deblur_avatar.imaging.exposure import encode
from deblur_avatar.rendering.mesh_rendering import View, render
from deblur_avatar.sources.studio.backdrop import draw_backdrop, street
from deblur_avatar.sources.studio.cameras import RingParams, place_cameras
from deblur_avatar.sources.studio.improvised import improvise
from deblur_avatar.sources.studio.motion import Moves
from deblur_avatar.sources.studio.passer_by import PasserBy, PasserByParams
from deblur_avatar.sources.studio.person import Person, create_person
from deblur_avatar.sources.studio.source import LIGHTING
from deblur_avatar.sources.studio.texture import LookParams

FPS, SIZE = 24.0, 640  # frames a second; pixels, of which a person is some 310 tall
RING = RingParams(training_height=1.3, test_heights=(1.3, 1.3), test_degrees=0.0, field=3.5)
TO_BE_SEEN = 1 / 3  # of her largest matte
CLEARLY = 2.0  # times as much of one person in a matte as of the others
LOOKS = {
    name: LookParams(dye=dye, wider=1.5, print_depth=0.3, print_m=0.05, tan=tan)
    for name, dye, tan in (("green", (2, 0, 1), 0.0), ("blue", (1, 2, 0), 0.4))
}
SAID = ("mixed up", "may be now one")  # of warnings
WHOSE = ("hers", "other's", "both")


class Walk(NamedTuple):
    """How somebody passes: z, negative behind the person; when she is beside her; in what."""

    depth_m: float
    speed_m_s: float
    middle_s: float = 1.25
    look: str | None = "green"  # None: the clothes of the person who is filmed

    def moves(self, person: Person, times: Float[Tensor, " F"], _: torch.Generator) -> Moves:
        """Of somebody who walks."""
        params = PasserByParams(
            depth_m=self.depth_m, speed_m_s=self.speed_m_s, middle_s=self.middle_s
        )
        return PasserBy(person, params).moves(times.double())


class Stay(NamedTuple):
    """Where somebody moves on the spot: x, to the side of the person; z; in what."""

    aside_m: float
    depth_m: float
    look: str | None = "green"

    def moves(self, _: Person, times: Float[Tensor, " F"], generator: torch.Generator) -> Moves:
        """Of somebody who moves beside the person."""
        moves = improvise(generator)(times, 1.0)
        aside = moves.transl.new_tensor([self.aside_m, 0.0, self.depth_m])
        return replace(moves, transl=moves.transl + aside)


CASES: Mapping[str, tuple[Walk | Stay, ...]] = {
    "slowly": (Walk(0.7, 0.8),),
    "fast": (Walk(0.7, 1.6),),
    "behind": (Walk(-0.8, 1.2),),
    "near the camera": (Walk(1.5, 1.2),),
    "far off": (Walk(-3.0, 1.6),),
    "same clothes": (Walk(0.7, 1.2, look=None),),
    "two": (Walk(0.7, 1.6, 0.6), Walk(0.9, 1.6, 1.9, "blue")),
    "nobody": (),
    "one beside": (Stay(-0.9, 0.2),),
    "at both sides": (Stay(-0.9, 0.2), Stay(0.9, -0.2, "blue")),
    "at both sides, one alike": (Stay(-0.9, 0.2), Stay(0.9, -0.2, None)),
    "beside, and one passes": (Stay(-0.9, 0.2, "blue"), Walk(0.7, 1.2)),
}


class Film(NamedTuple):
    """Frames, and how much of each pixel shows each person, the one who is filmed first."""

    pictures: UInt8[Tensor, "F H W 3"]
    mattes: Float[Tensor, "F N H W"]


def drawn(body: Body, others: Sequence[Walk | Stay], seed: int, frames: int) -> Film:
    """Draw somebody on the spot, whom others pass, or beside whom they stay."""
    generator = torch.Generator().manual_seed(seed)

    def somebody(look: str | None) -> Person:
        betas = SHAPE * torch.randn(body.shape_dirs.shape[2], generator=generator)
        return create_person(body, betas, LOOKS[look] if look else None)

    times = torch.arange(frames) / FPS
    people = [(0.0, (person := somebody(None)), person.posed(improvise(generator)(times, 1.0)))]
    for other in others:
        person = somebody(other.look)
        moves = other.moves(person, times, generator)
        people.append((other.depth_m, person, person.posed(moves)))
    view = View.of(place_cameras(2, SIZE, RING), 0, samples_per_axis=2)
    behind = draw_backdrop(street(np.random.default_rng(seed)), view.K, view.viewmat, (SIZE, SIZE))
    pictures, mattes = [], []
    order = sorted(range(len(people)), key=lambda who: people[who][0])
    for _ in range(frames):
        light, shares = behind, np.zeros((len(people), SIZE, SIZE), np.float32)
        for who in order:
            _, person, vertices = people[who]
            picture = render(next(vertices), person.mesh, view, LIGHTING)
            left = 1 - picture.coverage
            light, shares = picture.light + light * left[..., None], shares * left
            shares[who] = picture.coverage
        codes = encode(torch.from_numpy(np.asarray(light, np.float64)), "linear")
        pictures.append((codes * 255).round().to(torch.uint8))
        mattes.append(torch.from_numpy(shares))
    return Film(torch.stack(pictures), torch.stack(mattes))


def whose(track: Landmarks, mattes: Float[Tensor, "F N H W"]) -> dict[str, float]:
    """In what share of the frames a track's matte covers her, somebody else, or both."""
    found = track.found[:, None] * track.mattes.flatten(1).float() / 255
    covered = torch.einsum("fnp,fp->fn", mattes.flatten(2), found)
    hers, others = covered[:, 0], covered[:, 1:].sum(1)
    is_hers, is_others = hers > CLEARLY * others, others > CLEARLY * hers
    both = (hers + others > 0) & ~is_hers & ~is_others
    shares = (kind.float().mean() for kind in (is_hers, is_others, both))
    return {name: float(share) for name, share in zip(WHOSE, shares, strict=True)}


def seen(mattes: Float[Tensor, "F N H W"]) -> float:
    """In what share of the frames she is to be seen."""
    areas = mattes[:, 0].sum((1, 2))
    return float((areas >= TO_BE_SEEN * areas.max()).float().mean())


@contextmanager
def heard(lines: list[str]) -> Iterator[None]:
    """Gather what choosing a person warns of."""
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: lines.append(record.getMessage())  # type: ignore[method-assign]
    person_choice.logger.addHandler(handler)
    try:
        yield
    finally:
        person_choice.logger.removeHandler(handler)


def track_of_case(body: Body, name: str, seed: int, frames: int) -> dict[str, float]:
    """Draw one film and follow her, both ways."""
    film = drawn(body, CASES[name], seed, frames)
    tracks: list[Landmarks] = []
    said: list[str] = []

    def detect(pictures: UInt8[Tensor, "F H W 3"]) -> Landmarks:
        tracks.append(detect_with_mediapipe(pictures))
        return tracks[-1]

    with heard(said):
        taken, _ = detect_main_person(film.pictures, detect)
    rows = {"seen": seen(film.mattes)}
    for kind, track in (("first", tracks[0]), ("taken", taken)):
        rows |= {f"{kind}, {who}": share for who, share in whose(track, film.mattes).items()}
    return rows | {"said": float(any(word in line for line in said for word in SAID))}


def measure(body: Body, first: int, people: int, frames: int) -> dict[str, Any]:
    """Means over people, by case."""
    rows: dict[str, Any] = {}
    for name in CASES:
        takes = [track_of_case(body, name, seed, frames) for seed in range(first, first + people)]
        rows[name] = mean_of(takes, 3)
    return rows


def main() -> None:
    """Film and follow all people, print."""
    print_measured(__doc__, "cases", measure, frames=60, people=3)


if __name__ == "__main__":
    main()
