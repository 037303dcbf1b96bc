"""Mattes of people whose trousers have the floor's colour: trimmed by colour, and by limbs too.

    python -m benchmarks.same_colors [--frames 24] [--people 3] [--first 100] [--json FILE]

draws people who move on the spot and who do squats, filmed sharply and with half of each frame's
time open: before a street, in black shorts and shoes before a floor as black, and all in black,
black-haired, before a wall as black, too. Prints JSON, a film at a time: soft intersection over
union with the true mattes of what MediaPipe finds, of what is left when it is trimmed where a
picture shows the background (`preprocess.poses: estimated`), and of that where limbs of the
background's colour are left alone (`estimated_in_detail`). A quarter of an hour of one core for
three people, 2 GB.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from benchmarks.exercises import exercising, print_measured
from benchmarks.hands_and_head import SHAPE, exposed
from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.posed_body import shaped_joints, shaped_vertices
from deblur_avatar.body_estimation.landmarks import detect_with_mediapipe
from deblur_avatar.body_estimation.trimming import trimmed
from deblur_avatar.imaging.backgrounds import BackgroundEstimator
from deblur_avatar.imaging.overlap import soft_iou
from deblur_avatar.rendering.mesh_rendering import TexturedMesh, View, render
from deblur_avatar.sources.studio.backdrop import draw_backdrop, street
from deblur_avatar.sources.studio.cameras import RingParams, place_cameras
from deblur_avatar.sources.studio.clothes import PIECES, clothe
from deblur_avatar.sources.studio.improvised import improvise
from deblur_avatar.sources.studio.motion import Moves
from deblur_avatar.sources.studio.person import Person, create_person
from deblur_avatar.sources.studio.source import LIGHTING

FPS, SIZE = 12.0, 640  # frames a second; pixels, of which a person is some 500 tall
RING = RingParams(training_height=1.3, test_heights=(1.3, 1.3), test_degrees=0.0, field=2.3)
SHUTTERS = {"sharp": 1, "half open": 5}  # instants of half a frame's time
MOTIONS = ("on the spot", "squats")
BLACK = 0.012  # share of the light that black cloth sends back
DRESSES: dict[str, tuple[str, ...]] = {
    "a street": (),
    "a black floor": ("shorts", "shoes"),
    "all black": ("shirt", "shorts", "shoes", "hair"),
}
NOISE = 1.5  # codes
KINDS = ("found", "trimmed", "by limbs")


def in_black(body: Body, person: Person, pieces: Sequence[str]) -> Person:
    """The person in some pieces of clothing that are black."""
    clothed = clothe(
        shaped_vertices(body, person.betas).double().numpy(),
        shaped_joints(body, person.betas).double().numpy(),
        body.lbs_weights.double().numpy(),
        body.faces.numpy(),
    )
    dark = np.isin(clothed.pieces, [PIECES.index(piece) for piece in pieces])
    albedo = np.where(dark[:, None, None, None], np.float32(BLACK), person.mesh.albedo)
    return Person(body, person.betas, TexturedMesh(person.mesh.faces, albedo), person.drape)


def motion_of(
    body: Body, betas: Tensor, name: str, generator: torch.Generator, times: Tensor
) -> Moves:
    """How somebody moves."""
    if name == "squats":
        return exercising(body, betas, name, times, float(torch.rand((), generator=generator)))
    return improvise(generator)(times, float(times[-1]))


def filmed(
    body: Body, name: str, seed: int, frames: int, instants: int, before: str
) -> tuple[UInt8[Tensor, "F H W 3"], UInt8[Tensor, "F H W"]]:
    """Frames and their true mattes; each is the mean light of some instants."""
    generator = torch.Generator().manual_seed(seed)
    betas = SHAPE * torch.randn(body.shape_dirs.shape[2], generator=generator)
    person = in_black(body, create_person(body, betas), DRESSES[before])
    within = 0.5 * (torch.arange(instants) / instants)
    times = ((torch.arange(frames)[:, None] + within) / FPS).flatten()
    view = View.of(place_cameras(2, SIZE, RING), 0, samples_per_axis=2)
    behind = draw_backdrop(
        street(np.random.default_rng(seed)), view.K, view.viewmat, (SIZE, SIZE)
    ).copy()
    moves = motion_of(body, betas, name, generator, times)
    if before != "a street":
        picture = render(next(person.posed(moves)), person.mesh, view, LIGHTING)
        top = 0 if before == "all black" else waist_of(picture.coverage)
        behind[top:] = dark_of(picture.light, picture.coverage)
    shown, mattes = [], []
    for codes, matte in exposed(person, moves, view, behind, instants):
        noisy = codes + NOISE * torch.randn(codes.shape, generator=generator)
        shown.append(noisy.round().clamp(0, 255).to(torch.uint8))
        mattes.append(matte)
    return torch.stack(shown), torch.stack(mattes)


def waist_of(coverage: Float[np.ndarray, "H W"]) -> int:
    """The row at half a person's height."""
    rows = np.nonzero((coverage > 0.9).any(1))[0]
    return int(rows[0] + rows[-1]) // 2


def dark_of(
    light: Float[np.ndarray, "H W 3"], coverage: Float[np.ndarray, "H W"]
) -> Float[np.ndarray, " 3"]:
    """What black clothes look like in a picture: the median of the darker half of her legs."""
    legs = (coverage > 0.99) & (np.arange(len(coverage))[:, None] > waist_of(coverage))
    worn = light[legs]
    return np.median(worn[worn.sum(1) <= np.median(worn.sum(1))], axis=0)


def overlaps(frames: UInt8[Tensor, "F H W 3"], true: UInt8[Tensor, "F H W"]) -> dict[str, float]:
    """Of what is found, and of that trimmed both ways."""
    person = detect_with_mediapipe(frames)
    behind = BackgroundEstimator(frames).background("median", person.mattes)
    cut = [trimmed(frames, person, behind, by_limbs=by_limbs) for by_limbs in (False, True)]
    people = (person, *cut)
    found = {}
    for kind, one in zip(KINDS, people, strict=True):
        overlap = soft_iou(one.mattes.float(), true.float())
        assert overlap is not None, "nobody was drawn"
        found[kind] = overlap
    return found


def measure(body: Body, first: int, people: int, frames: int) -> dict[str, Any]:
    """Means over people, by dress, motion and shutter."""
    rows: dict[str, Any] = {}
    for before in DRESSES:
        for name in MOTIONS:
            for shutter, instants in SHUTTERS.items():
                takes = [
                    overlaps(*filmed(body, name, seed, frames, instants, before))
                    for seed in range(first, first + people)
                ]
                rows[f"{name}, {before}, {shutter}"] = {
                    kind: round(sum(take[kind] for take in takes) / people, 3) for kind in KINDS
                }
    return rows


def main() -> None:
    """Film, find and trim all people, print."""
    print_measured(__doc__, "same_colors", measure, frames=24, people=3)


if __name__ == "__main__":
    main()
