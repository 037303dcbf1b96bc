"""Acting: any motion, built in or from a file, done in the studio by any person.

Conventions. The studio's world and `Moves`. Times are in seconds from the start of the clip; M
instants. Whoever acts stays near the vertical through the middle of the studio.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from torch import Tensor

from deblur_avatar.animation.motion_files import BUILTIN, read_motion
from deblur_avatar.artifacts.body import Body
from deblur_avatar.bodies.posed_body import posed_vertices, shaped_joints
from deblur_avatar.config.reading import expand_environment, missing_file
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import (
    axis_angle_to_matrix,
    axis_angle_to_quat,
    continuous,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.sources.studio.motion import MOTIONS, Motion, Moves

SAMPLES = 120.0  # a second, of a file's motion, between which a smooth curve is laid
MARGIN = 0.05  # seconds sampled after the end, so that the last instants lie within the curve
FLOOR_SAMPLES = 30  # a second, among which the lowest point is looked for


@dataclass(frozen=True)
class Act:
    """What is done."""

    motion: str  # of `MOTIONS`, `builtin:<name>` or a file's path
    start: float  # seconds into a motion that is not of `MOTIONS`
    turns: float  # whole turns about the vertical that are added over the clip
    seconds: float  # length of the clip


def learn(act: Act, body: Body, betas: Float[Tensor, " B"]) -> Motion:
    """Make a motion one person's own.

    Of a motion that is not of `MOTIONS` the lowest point of the body over the clip stands on the
    floor, and the mean place is the middle of the studio.

    Args:
        act: what is done.
        body: who does it; files are retargeted to it.
        betas: its shape numbers.

    Raises:
        ConfigError: if there is no such motion, or it ends before the clip does.
        ArtifactError: if a file is damaged.
    """
    motion = MOTIONS.get(act.motion) or _placed(_of_file(act, body, betas), act, body, betas)
    if act.turns == 0:
        return motion
    pelvis = shaped_joints(body, betas)[0].double()

    def turned(times: Float[Tensor, " M"], training_seconds: float) -> Moves:
        moves = motion(times, training_seconds)
        angle = 2 * math.pi * act.turns * times.double() / act.seconds
        around = torch.stack([0 * angle, angle, 0 * angle], -1)
        orient = quat_multiply(axis_angle_to_quat(around), axis_angle_to_quat(moves.global_orient))
        place = axis_angle_to_matrix(around) @ (moves.transl + pelvis)[..., None]
        return Moves(quat_to_axis_angle(orient), moves.body_pose, place[..., 0] - pelvis)

    return turned


def missing_motion(name: str, where: str) -> tuple[str, ...]:
    """Why a motion cannot be read here: one reason, or none if it is there or built in."""
    if name in MOTIONS or name.startswith(BUILTIN):
        return ()
    return missing_file(name, where, "motion file")


def _of_file(act: Act, body: Body, betas: Float[Tensor, " B"]) -> Motion:
    """A smooth curve through what a file says."""
    path = expand_environment(act.motion, "clip.motion")
    length = act.seconds + MARGIN
    read = read_motion(path, body, betas, fps=SAMPLES, start=act.start, seconds=length)
    if read.seconds < act.seconds:
        raise ConfigError(
            f"{path}: from {act.start:g} s on there are {read.seconds:.2f} s of motion, the clip "
            f"lasts {act.seconds:.2f} s; start earlier or take fewer frames"
        )
    axis_angle = torch.cat([read.global_orient[:, None], read.body_pose], 1).double()
    quats = continuous(axis_angle_to_quat(axis_angle))
    sampled = torch.arange(len(quats), dtype=torch.float64) / SAMPLES
    turns, places = (CubicSpline(sampled, values) for values in (quats, read.transl.double()))

    def motion(times: Float[Tensor, " M"], training_seconds: float) -> Moves:
        turn = torch.nn.functional.normalize(torch.from_numpy(turns(times)), dim=-1)
        axis_angle = quat_to_axis_angle(turn)
        return Moves(axis_angle[:, 0], axis_angle[:, 1:], torch.from_numpy(places(times)))

    return motion


def _placed(motion: Motion, act: Act, body: Body, betas: Float[Tensor, " B"]) -> Motion:
    """The motion on the floor, in the middle of the studio."""
    count = math.ceil(act.seconds * FLOOR_SAMPLES)
    seen = motion(torch.arange(count, dtype=torch.float64) / FLOOR_SAMPLES, act.seconds)
    poses = (seen.global_orient, seen.body_pose, seen.transl)
    lowest = posed_vertices(body, betas.double(), *poses)[..., 1].min()
    pelvis = shaped_joints(body, betas)[0].double() + seen.transl.mean(0)
    away = torch.stack([pelvis[0], lowest, pelvis[2]])

    def placed(times: Float[Tensor, " M"], training_seconds: float) -> Moves:
        moves = motion(times, training_seconds)
        return Moves(moves.global_orient, moves.body_pose, moves.transl - away)

    return placed
