"""Motions of the stress suite, chosen for what they break.

Conventions. The studio's (`sources/studio/motion.py`): SMPL's pose, seconds from the start of the
clip, the training part first. M instants. All but `extremes` go on in the held-out part as before.
"""

import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.sources.studio.motion import (
    Moves,
    still,
    turn,
)

FOREARM_SPEED = math.radians(1500.0)  # per second, the fastest
FOREARM_SWING = math.radians(70.0)  # to either side: all that an elbow can
STANDING_BEND = 0.4  # radians, of the elbows of a person who stands still
CROSSING_PERIOD = 0.3  # seconds in which the arm sweeps over the chest and back
EXPOSURE = 33 / 480  # seconds, of the window that the reversals are made for
SWING = 0.4  # radians to either side, of arms that reverse
DRIFT, DRIFT_PERIOD = math.radians(25.0), 1.6  # of a person who mostly faces the camera
X, Y, Z = range(3)

Angles = Float[Tensor, " M"]


def stability_move(name: str, times: Float[Tensor, " M"], training_seconds: float) -> Moves:
    """Evaluate a motion by name.

    Raises:
        ConfigError: for a name that is not known.
    """
    if name not in STABILITY_MOTIONS:
        raise ConfigError(f"no motion {name!r}; known: {', '.join(STABILITY_MOTIONS)}")
    return STABILITY_MOTIONS[name](times.double(), training_seconds)


def _narrow(degrees: float) -> Callable[[Angles, float], Moves]:
    """The studio's moves, but facing the camera all the time, up to so many degrees off."""

    def move(times: Angles, training_seconds: float) -> Moves:
        yaw = math.radians(degrees) * torch.sin(2 * torch.pi * times / training_seconds)
        return _facing(turn(times, training_seconds), yaw)

    return move


def _limbs(times: Angles, training_seconds: float) -> Moves:
    """Forearms at 1500 degrees a second, the rest of the body still."""
    standing = still(times, training_seconds)
    wave = FOREARM_SWING * torch.sin(FOREARM_SPEED / FOREARM_SWING * times)
    moves = _turned(standing, "left_elbow", Y, wave - FOREARM_SWING + STANDING_BEND)
    return _turned(moves, "right_elbow", Y, wave + FOREARM_SWING - STANDING_BEND)


def _crossing(times: Angles, training_seconds: float) -> Moves:
    """The right forearm sweeps across the chest."""
    sweep = 0.75 + 0.75 * torch.sin(2 * torch.pi * times / CROSSING_PERIOD)
    moves = _turned(_drifting(times, training_seconds), "right_shoulder", Y, sweep)
    return _turned(moves, "right_elbow", Y, 0.6 * torch.ones_like(times))


def _reversing(
    periods: float, wave: Callable[[Angles], Angles]
) -> Callable[[Angles, float], Moves]:
    """Both arms go up and down with a period of so many exposures."""

    def move(times: Angles, training_seconds: float) -> Moves:
        angle = SWING * wave(times / (periods * EXPOSURE))
        moves = _turned(_drifting(times, training_seconds), "left_shoulder", Z, angle + SWING)
        return _turned(moves, "right_shoulder", Z, -angle - SWING)

    return move


def _extremes(times: Angles, training_seconds: float) -> Moves:
    """The studio's moves, then a split, a deep crouch and a T-pose that training never saw."""
    moves = turn(times, training_seconds)
    after = times - training_seconds
    third = (float(times.max()) - training_seconds) / 3
    shown = [after >= 0, after >= third, after >= 2 * third]
    split, crouch = shown[0] & ~shown[1], shown[1] & ~shown[2]
    pose = moves.body_pose.clone()
    for index, name in enumerate(SMPL_JOINT_NAMES[1:]):
        pose[shown[0], index] = 0.0
        side = 1.0 if name.startswith("left") else -1.0
        if name.endswith("hip"):
            pose[split, index, Z] = 1.3 * side
            pose[crouch, index, X] = -1.9
        if name.endswith("knee"):
            pose[crouch, index, X] = 2.2
    return Moves(moves.global_orient, pose, moves.transl)


def _drifting(times: Angles, training_seconds: float) -> Moves:
    """Standing, turning a little."""
    yaw = DRIFT * torch.sin(2 * torch.pi * times / DRIFT_PERIOD)
    return _facing(still(times, training_seconds), yaw)


def _facing(moves: Moves, yaw: Angles) -> Moves:
    """The same moves of a person turned by `yaw` from the camera."""
    orient = torch.zeros_like(moves.global_orient)
    orient[:, Y] = yaw
    return Moves(orient, moves.body_pose, moves.transl)


def _turned(moves: Moves, joint: str, axis: int, angles: Angles) -> Moves:
    """Turn one joint further, in its parent's frame, after what it does."""
    index = SMPL_JOINT_NAMES.index(joint) - 1
    step = torch.zeros_like(moves.body_pose[:, index])
    step[:, axis] = angles
    pose = moves.body_pose.clone()
    before = axis_angle_to_quat(pose[:, index])
    pose[:, index] = quat_to_axis_angle(quat_multiply(axis_angle_to_quat(step), before))
    return Moves(moves.global_orient, pose, moves.transl)


def _sine(phase: Angles) -> Angles:
    return torch.sin(2 * torch.pi * phase)


def _triangle(phase: Angles) -> Angles:
    return 2 / torch.pi * torch.asin(torch.sin(2 * torch.pi * phase))


STABILITY_MOTIONS: dict[str, Callable[[Angles, float], Moves]] = {
    "turn": turn,
    "still": still,
    "narrow_20": _narrow(20.0),
    "narrow_60": _narrow(60.0),
    "limbs": _limbs,
    "crossing": _crossing,
    "sine_slow": _reversing(4.0, _sine),
    "sine_fast": _reversing(2.0, _sine),
    "triangle_slow": _reversing(4.0, _triangle),
    "triangle_fast": _reversing(2.0, _triangle),
    "extremes": _extremes,
}
