"""Poses of people whose legs the picture's lower edge cuts off, seen now and then or never.

    python -m benchmarks.cut_off [--frames 96] [--people 3] [--first 100] [--json FILE]

draws people of known poses before a street, cuts the pictures off below the hips, between hips and
knees, and at the knees, finds them with MediaPipe and fits the body, in any pose as for a new clip.
Prints JSON, by where the edge is: joints' mean distance from the truth after the best similarity of
each frame, mm; how far thighs and shins are turned from the truth, degrees in the mean; and the
share of frames in which a knee is found. Four minutes of one core for three people, 5 GB; no
avatar.
"""

from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.exercises import improvised, mean_of, print_measured
from benchmarks.hands_and_head import RING, SIZE
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.body_estimation.body_fit import fit_body
from deblur_avatar.body_estimation.landmark_track import LOST
from deblur_avatar.body_estimation.landmarks import detect_with_mediapipe
from deblur_avatar.evaluation.estimated_steps import joint_errors
from deblur_avatar.geometry.cameras import project
from deblur_avatar.sources.studio.cameras import place_cameras

EDGES = {"below the hips": 0.25, "above the knees": 0.75, "at the knees": 1.0}  # from hip to knee
KNEES = (25, 26)  # MediaPipe's


def edge_row(joints: Float[Tensor, "F J 3"], body: Body, cameras: Cameras, share: float) -> int:
    """The row so far from hips to knees, medians over the clip, in the first camera."""
    rows = project(joints, cameras.Ks[0], cameras.viewmats[0])[0][..., 1]
    hips, knees = (
        rows[:, [body.joint_names.index(f"{side}_{joint}") for side in ("left", "right")]].median()
        for joint in ("hip", "knee")
    )
    return round(float(hips + share * (knees - hips)))


def leg_degrees(
    body: Body, found: Float[Tensor, "F J 3"], true: Float[Tensor, "F J 3"]
) -> Float[Tensor, "F 4"]:
    """Angles between thighs and shins and true ones."""
    apart = []
    for side in ("left", "right"):
        for upper, lower in (("hip", "knee"), ("knee", "ankle")):
            ends = [body.joint_names.index(f"{side}_{joint}") for joint in (upper, lower)]
            bones = [
                torch.nn.functional.normalize(joints[:, ends[1]] - joints[:, ends[0]], dim=-1)
                for joints in (found, true)
            ]
            apart.append(torch.rad2deg((bones[0] * bones[1]).sum(-1).clamp(-1, 1).acos()))
    return torch.stack(apart, dim=-1)


def errors_of_person(body: Body, seed: int, frames: int) -> dict[str, dict[str, float]]:
    """Draw a person, cut her off, fit her; errors by where the edge is."""
    whole = place_cameras(2, SIZE, RING)
    pictures, mattes, true, times = improvised(body, seed, frames, whole)
    joints = posed(body, true).joints
    rows: dict[str, dict[str, float]] = {}
    for name, share in EDGES.items():
        height = edge_row(joints, body, whole, share)
        sizes = whole.sizes.clone()
        sizes[:, 1] = height
        cameras = replace(whole, sizes=sizes)
        seen = detect_with_mediapipe(pictures[:, :height].contiguous())
        seen = replace(seen, mattes=mattes[:, :height].contiguous())
        poses: Poses = fit_body(body, cameras, (0,), [seen], times, any_pose=True).poses
        fitted = posed(body, poses).joints
        rows[name] = {
            "registered_mm": joint_errors(fitted, joints)["registered_mm"],
            "legs_degrees": float(leg_degrees(body, fitted, joints).mean()),
            "knee_found": float((seen.visibility[:, KNEES] >= LOST).any(1).float().mean()),
        }
    return rows


def measure(body: Body, first: int, people: int, frames: int) -> dict[str, Any]:
    """Means over people, by where the edge is."""
    seeds = range(first, first + people)
    return mean_of([errors_of_person(body, seed, frames) for seed in seeds], 3)


def main() -> None:
    """Film, cut off, find, fit, print."""
    print_measured(__doc__, "edge", measure, frames=96, people=3)


if __name__ == "__main__":
    main()
