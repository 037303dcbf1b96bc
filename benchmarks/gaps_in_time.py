"""Poses beside a gap in time, where frames were dropped or repeats of a frozen stream left out.

    python -m benchmarks.gaps_in_time [--frames 96] [--people 3] [--first 100] [--json FILE]

draws people of known poses before a street, finds them with MediaPipe, leaves out the frames of so
many seconds in the middle, and fits the body, in any pose as for a new clip. Prints JSON, by the
seconds that are missing: of the two frames beside the gap, and of all others, joints' mean distance
from the truth after the best similarity of each frame, mm, and landmarks' mean distance from where
they were found, pixels (she is some 750 tall). Four minutes of one core for three people, 5 GB; no
avatar.
"""

from dataclasses import replace
from typing import Any

from torch import Tensor

from benchmarks.exercises import improvised, mean_of, print_measured
from benchmarks.hands_and_head import FPS, RING, SIZE
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.body_estimation.body_fit import BodyFit, fit_body
from deblur_avatar.body_estimation.landmarks import Landmarks, detect_with_mediapipe
from deblur_avatar.evaluation.estimated_steps import joint_errors
from deblur_avatar.sources.studio.cameras import place_cameras

MISSING_S = (0.0, 0.2, 0.5, 1.0)


def kept_frames(frames: int, missing: int) -> list[int]:
    """All but so many in the middle."""
    start = (frames - missing) // 2
    return [*range(start), *range(start + missing, frames)]


def at(person: Landmarks, kept: list[int]) -> Landmarks:
    """What was found in some of the frames."""
    return replace(
        person,
        found=person.found[kept],
        points=person.points[kept],
        visibility=person.visibility[kept],
        mattes=person.mattes[kept],
        world=None if person.world is None else person.world[kept],
    )


def measured(body: Body, fit: BodyFit, true: Poses, frames: list[int]) -> dict[str, float]:
    """Errors of some of the frames that were fitted."""
    joints = [posed(body, poses.at(frames)).joints for poses in (fit.poses, true)]
    residuals: Tensor = fit.residuals[0, frames]
    return {
        "registered_mm": joint_errors(*joints)["registered_mm"],
        "reprojection_px": float(residuals[residuals > 0].mean()),
    }


def errors_of_person(
    body: Body, seed: int, frames: int
) -> dict[float, dict[str, dict[str, float]]]:
    """Draw a person; errors by the seconds that are missing, beside the gap and elsewhere."""
    cameras = place_cameras(2, SIZE, RING)
    pictures, mattes, true, times = improvised(body, seed, frames, cameras)
    found = replace(detect_with_mediapipe(pictures), mattes=mattes)
    rows: dict[float, dict[str, dict[str, float]]] = {}
    for seconds in MISSING_S:
        kept = kept_frames(frames, round(seconds * FPS))
        fit = fit_body(body, cameras, (0,), [at(found, kept)], times[kept], any_pose=True)
        middle = (frames - round(seconds * FPS)) // 2
        parts = {"beside": [middle - 1, middle]}
        parts["elsewhere"] = [f for f in range(len(kept)) if f not in parts["beside"]]
        rows[seconds] = {
            name: measured(body, fit, true.at(kept), chosen) for name, chosen in parts.items()
        }
    return rows


def measure(body: Body, first: int, people: int, frames: int) -> dict[str, Any]:
    """Means over people, by the seconds that are missing."""
    seeds = range(first, first + people)
    return mean_of([errors_of_person(body, seed, frames) for seed in seeds], 1)


def main() -> None:
    """Film, find, fit without some frames, print."""
    print_measured(__doc__, "missing_s", measure, frames=96, people=3)


if __name__ == "__main__":
    main()
