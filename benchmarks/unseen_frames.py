"""Poses of frames in which nobody is seen: the fit's own, and a straight way between those seen.

    python -m benchmarks.unseen_frames [--frames 96] [--people 3] [--first 100] [--json FILE]

draws people of known poses before a street, finds them with MediaPipe, takes what was found from
the frames in the middle, as if they had left the picture, and fits the body, in any pose as for a
new clip. Prints JSON, by how long nobody was seen, seconds: joints' mean distance from the truth
over those frames, after the best similarity of each and after the pelvis was put in place, mm, of
the fit as it is, of poses filled between (`between_seen`), and of a fit that saw everything; and
how far from rest joints are turned there, degrees in the mean. Five minutes of one core for three
people, 5.5 GB; no avatar.
"""

from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Bool
from torch import Tensor

from benchmarks.exercises import improvised, mean_of, print_measured
from benchmarks.hands_and_head import FPS, RING, SIZE
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.body_estimation.body_fit import fit_body
from deblur_avatar.body_estimation.landmarks import Landmarks, detect_with_mediapipe
from deblur_avatar.body_estimation.unseen_frames import between_seen
from deblur_avatar.evaluation.estimated_steps import joint_errors
from deblur_avatar.sources.studio.cameras import place_cameras

UNSEEN_S = (0.125, 0.25, 0.375, 0.5, 1.0, 2.0)


def unfound(person: Landmarks, hidden: Bool[Tensor, " F"]) -> Landmarks:
    """What a detector says that finds nobody in some frames."""
    kept = (~hidden).to(person.points)[:, None]
    return replace(
        person,
        found=person.found & ~hidden,
        points=person.points * kept[..., None],
        visibility=person.visibility * kept,
        world=None if person.world is None else person.world * kept[..., None],
        mattes=torch.where(hidden[:, None, None], 0, person.mattes),
    )


def measured(body: Body, poses: Poses, true: Poses, hidden: Bool[Tensor, " F"]) -> dict[str, float]:
    """How far poses of hidden frames are from the truth, and from rest."""
    at = torch.nonzero(hidden).flatten()
    errors = joint_errors(posed(body, poses.at(at)).joints, posed(body, true.at(at)).joints)
    turned = torch.rad2deg(poses.at(at).body_pose.norm(dim=-1))
    distances = {key: errors[key] for key in ("registered_mm", "rooted_mm")}
    return {**distances, "turned": float(turned.mean())}


def errors_of_person(
    body: Body, seed: int, frames: int
) -> dict[float, dict[str, dict[str, float]]]:
    """Draw a person; errors by how long nobody is seen and by what fills the gap."""
    cameras = place_cameras(2, SIZE, RING)
    pictures, mattes, true, times = improvised(body, seed, frames, cameras)
    found = replace(detect_with_mediapipe(pictures), mattes=mattes)
    whole = fit_body(body, cameras, (0,), [found], times, any_pose=True).poses
    rows: dict[float, dict[str, dict[str, float]]] = {}
    for seconds in UNSEEN_S:
        count = round(seconds * FPS)
        hidden = torch.zeros(frames, dtype=torch.bool)
        hidden[(frames - count) // 2 :][:count] = True
        seen = unfound(found, hidden)
        fit = fit_body(body, cameras, (0,), [seen], times, any_pose=True).poses
        between = between_seen(fit, ~hidden, times)
        kinds = {"fit": fit, "between": between, "seen": whole, "true": true}
        rows[seconds] = {name: measured(body, poses, true, hidden) for name, poses in kinds.items()}
    return rows


def measure(body: Body, first: int, people: int, frames: int) -> dict[str, Any]:
    """Means over people, by how long nobody is seen."""
    seeds = range(first, first + people)
    return mean_of([errors_of_person(body, seed, frames) for seed in seeds], 1)


def main() -> None:
    """Film, find, fit without some frames, print."""
    print_measured(__doc__, "unseen_s", measure, frames=96, people=3)


if __name__ == "__main__":
    main()
