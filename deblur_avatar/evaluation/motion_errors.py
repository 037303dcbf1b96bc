"""Motion errors: joints, surface, angles and travel against the true motion.

Conventions. Positions are compared in the world, metres in and millimetres out, without any
alignment: cameras are calibrated. Travel is how far a joint gets while the shutter is open. Where
the instants of a motion span only part of the exposure it is divided by that part, so that ways to
sample can be compared. A single blurred frame tells motion only up to the direction of time: travel
errors forgive a reversal of a whole frame, `direction_accuracy` counts it. J joints, F frames, S
instants, M samples of the truth.
"""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.geometry.rotations import (
    axis_angle_to_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
)

MOVING = 0.02  # metres a joint must travel in an exposure before its direction counts


def pose_errors(body: Body, estimated: Poses, true: Poses) -> dict[str, float]:
    """Errors of F poses, averaged over frames and joints (or vertices).

    Args:
        body: whose joints and surface; both sets of poses bring their own shape.
        estimated: F poses.
        true: the same instants.

    Returns:
        `joint_error_mm`, `surface_error_mm` (of the vertices), and `joint_error_deg`: the angle
        between the estimated and the true rotation of each joint relative to its parent, of the
        root relative to the world.
    """
    joints = posed(body, estimated).joints - posed(body, true).joints
    # Frame by frame: the blend shapes of 100 poses of 14,000 vertices would fill a gigabyte.
    surface = [
        (posed(body, estimated.at([i])).vertices - posed(body, true.at([i])).vertices)
        .norm(dim=-1)
        .mean()
        for i in range(len(true.transl))
    ]
    found, wanted = (axis_angle_to_quat(poses.axis_angle) for poses in (estimated, true))
    turn = quat_to_axis_angle(quat_multiply(quat_conjugate(found), wanted))
    return {
        "joint_error_mm": 1e3 * float(joints.norm(dim=-1).mean()),
        "surface_error_mm": 1e3 * float(torch.stack(surface).mean()),
        "joint_error_deg": math.degrees(float(turn.norm(dim=-1).mean())),
    }


def travel_errors(
    body: Body,
    motion: Motion,
    exposure: float,
    frames: Sequence[int],
    true_times: Float[Tensor, " M"],
    true: Poses,
) -> dict[str, float | None]:
    """Errors of the motion inside exposures, averaged over joints and `frames`.

    Args:
        body: whose joints.
        motion: estimated; a single instant counts as no travel.
        exposure: seconds the shutter was open.
        frames: rows of `motion` that were fitted.
        true_times: seconds, increasing.
        true: poses at these times; between them joints are taken to move straight.

    Returns:
        `travel_error_mm`: the length of the difference of displacements, in the better of the two
        directions of time; `direction_accuracy`: of the joints that travel more than `MOVING`, the
        share that goes the true way (within 90 degrees), None for a single instant or where no
        joint travels.
    """
    chosen = torch.tensor(frames)
    still = len(motion.u) == 1
    first, last = (0.0, 1.0) if still else (float(motion.u[0]), float(motion.u[-1]))
    middle = motion.timestamps[chosen]
    path = posed(body, true).joints
    opened, closed = (
        _interpolated(path, true_times, middle + (u - 0.5) * exposure) for u in (first, last)
    )
    true_travel = (closed - opened) / (last - first)
    opened, closed = (posed(body, instant(motion, index).at(chosen)).joints for index in (0, -1))
    travel = (closed - opened) / (last - first)
    forward = (travel - true_travel).norm(dim=-1).mean(-1)
    backward = (travel + true_travel).norm(dim=-1).mean(-1)
    moving = true_travel.norm(dim=-1) > MOVING
    right = ((travel * true_travel).sum(-1) > 0) & moving
    told = not still and bool(moving.any())
    return {
        "travel_error_mm": 1e3 * float(torch.minimum(forward, backward).mean()),
        "direction_accuracy": float(right.sum() / moving.sum()) if told else None,
    }


def instant(motion: Motion, index: int) -> Poses:
    """The poses of all frames at one of a motion's instants."""
    return Poses(
        betas=motion.centre.betas,
        global_orient=motion.global_orient[:, index],
        body_pose=motion.body_pose[:, index],
        transl=motion.transl[:, index],
    )


def _interpolated(
    values: Float[Tensor, "M J 3"], sampled: Float[Tensor, " M"], times: Float[Tensor, " F"]
) -> Float[Tensor, "F J 3"]:
    """Values on the straight lines between samples; beyond them, the nearest."""
    after = torch.searchsorted(sampled, times).clamp(1, len(sampled) - 1)
    start, end = sampled[after - 1], sampled[after]
    share = ((times - start) / (end - start)).clamp(0, 1)[:, None, None]
    return values[after - 1] * (1 - share) + values[after] * share
