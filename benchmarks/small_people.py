"""In how many frames people are found who are small in the picture, before and at a closer look.

    python -m benchmarks.small_people [--frames 20] [--people 2] [--first 100] [--json FILE]

draws people of known poses in the middle of a street, smaller and smaller, as they squat, sit up,
do push-ups and sit (`benchmarks.exercises`), sharply, 960 pixels square. Prints JSON, by the
person's height in pixels when she stands: in what share of the frames somebody is found where she
is, in whole frames (`detect_with_mediapipe`) and with a closer look (`look_closer`); and how often
elsewhere. Ten minutes of one core, 3 GB.
"""

from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from benchmarks.exercises import EXERCISES, drawn, print_measured
from benchmarks.hands_and_head import SIZE
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.body_estimation.closer_look import look_closer
from deblur_avatar.body_estimation.landmarks import Landmarks, detect_with_mediapipe
from deblur_avatar.body_estimation.same_person import SURE
from deblur_avatar.geometry.cameras import project
from deblur_avatar.sources.studio.cameras import RingParams, place_cameras

HEIGHTS = (50, 70, 100, 150, 250)  # pixels of who stands
TALL = 1.7  # metres, about
BESIDE = 0.5  # of her size: found farther from her middle, it is not she


def camera_for(height: int) -> Cameras:
    """Cameras of which the first sees who stands as tall as that."""
    ring = RingParams(
        training_height=1.3, test_heights=(1.3, 1.3), test_degrees=0.0,
        field=TALL * SIZE / height,
    )  # fmt: skip
    return place_cameras(2, SIZE, ring)


def in_place(person: Landmarks, boxes: Float[Tensor, "F 4"]) -> Bool[Tensor, " F"]:
    """Whether each frame's sure landmarks lie about the middle of its true box.

    Args:
        person: as she was found.
        boxes: left, top, right, bottom of the true body, pixels.
    """
    sure = (person.visibility >= SURE)[..., None]
    low = torch.where(sure, person.points, torch.inf).amin(1)
    high = torch.where(sure, person.points, -torch.inf).amax(1)
    middles, sizes = (boxes[:, :2] + boxes[:, 2:]) / 2, (boxes[:, 2:] - boxes[:, :2]).amax(1)
    away = ((low + high) / 2 - middles).norm(dim=1)
    return person.found & sure[..., 0].any(1) & (away < BESIDE * sizes)


def found(body: Body, name: str, seed: int, frames: int, height: int) -> dict[str, Tensor]:
    """Where somebody is found in each frame of a film, both ways."""
    cameras = camera_for(height)
    pictures, _, true, _ = drawn(body, name, seed, frames, cameras)
    pixels, _ = project(posed(body, true).vertices, cameras.Ks[0], cameras.viewmats[0])
    boxes = torch.cat([pixels.amin(1), pixels.amax(1)], dim=1)
    first = detect_with_mediapipe(pictures)
    closer = look_closer(pictures, first)
    return {
        f"{way}, {where}": hers if where == "found" else person.found & ~hers
        for way, person in (("whole frames", first), ("closer", closer))
        for hers in (in_place(person, boxes),)
        for where in ("found", "elsewhere")
    }


def measure(body: Body, first: int, people: int, frames: int) -> dict[str, Any]:
    """Shares of all frames, by height."""
    rows: dict[str, Any] = {}
    for height in HEIGHTS:
        takes = [
            found(body, name, seed, frames, height)
            for name, exercise in EXERCISES.items()
            if not exercise.hides
            for seed in range(first, first + people)
        ]
        rows[str(height)] = {
            key: round(float(torch.cat([take[key] for take in takes]).float().mean()), 3)
            for key in takes[0]
        }
    return rows


def main() -> None:
    """Film and find all people, print."""
    print_measured(__doc__, "pixels tall", measure, frames=20, people=2)


if __name__ == "__main__":
    main()
