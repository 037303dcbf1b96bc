"""Poses at any instant of an exposure, as a fitted motion knows them.

A motion with several instants an exposure is interpolated between them. Where each frame was fitted
for itself its direction of time is arbitrary: it is turned to agree with the frames around. A
motion of one instant a frame is interpolated between frames.
"""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.geometry.rotations import turn_between
from deblur_avatar.motion.kinds import kind_of


def pose_at(
    body: Body, motion: Motion, exposure: float | None, position: int, offset: float
) -> Poses:
    """The pose at one instant.

    Args:
        body: whose joints tell which way time goes.
        motion: fitted.
        exposure: seconds the shutter was open, as observed; a motion that estimated it knows best.
        position: of the frame in the observations.
        offset: seconds from the middle of the frame's exposure; beyond the exposure its end counts.
    """
    if offset == 0:
        return motion.centre.at([position])
    shutter = motion.exposure(exposure)
    if len(motion.u) == 1 or not shutter:
        return _between_frames(motion, position, offset)
    row = exposure_of(motion, position)
    if not kind_of(motion).knows_unfitted and _runs_backward(body, motion, position, row):
        row = row.at(list(reversed(range(len(row.transl)))))
    u = min(max(0.5 + offset / shutter, float(motion.u[0])), float(motion.u[-1]))
    after = int(torch.searchsorted(motion.u, u).clamp(1, len(motion.u) - 1))
    start, end = float(motion.u[after - 1]), float(motion.u[after])
    return between(row.at([after - 1]), row.at([after]), (u - start) / (end - start))


def exposure_of(motion: Motion, position: int) -> Poses:
    """The sampled instants of one frame's exposure."""
    return Poses(
        betas=motion.centre.betas,
        global_orient=motion.global_orient[position],
        body_pose=motion.body_pose[position],
        transl=motion.transl[position],
    )


def between(start: Poses, end: Poses, share: float) -> Poses:
    """Poses a share of the way from some to as many others, along the shortest arcs."""
    mixed = turn_between(start.axis_angle, end.axis_angle, torch.full((len(start.transl),), share))
    transl = start.transl + share * (end.transl - start.transl)
    return replace(start, global_orient=mixed[:, 0], body_pose=mixed[:, 1:], transl=transl)


def joints_apart(a: Float[Tensor, "S J 3"], b: Float[Tensor, "S J 3"]) -> float:
    """Sum of squared distances, square metres."""
    return float((a - b).square().sum())


def _between_frames(motion: Motion, position: int, offset: float) -> Poses:
    """Between the middles of two exposures; before the first and after the last, theirs."""
    other = position + (1 if offset > 0 else -1)
    if not 0 <= other < len(motion.timestamps):
        return motion.centre.at([position])
    interval = float(motion.timestamps[other] - motion.timestamps[position])
    here, there = motion.centre.at([position]), motion.centre.at([other])
    return between(here, there, min(offset / interval, 1.0))


def _runs_backward(body: Body, motion: Motion, position: int, row: Poses) -> bool:
    """Whether joints go against the way from the frame before to the frame after."""
    around = [max(position - 1, 0), min(position + 1, len(motion.timestamps) - 1)]
    before, after = posed(body, motion.centre.at(around)).joints
    instants = posed(body, row.at([0, len(row.transl) - 1])).joints
    return float(((instants[1] - instants[0]) * (after - before)).sum()) < 0
