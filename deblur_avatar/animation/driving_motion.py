"""Driving motion: poses or a skeleton's rotations over time, resampled.

Conventions. The world has +Y up. Frames are equally spaced, `fps` of them a second. F frames,
J joints of a source skeleton, parents before children.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.geometry.pose_interpolation import interpolated


@dataclass(frozen=True, kw_only=True)
class BodyMotion:
    """Poses of SMPL's 24 joints over time: axis-angle, radians, metres."""

    fps: float
    global_orient: Float[Tensor, "F 3"]
    body_pose: Float[Tensor, "F 23 3"]
    transl: Float[Tensor, "F 3"]

    @property
    def seconds(self) -> float:
        """Time from the first frame to the last."""
        return (len(self.transl) - 1) / self.fps


@dataclass(frozen=True, kw_only=True)
class SkeletonMotion:
    """A named skeleton of any rest pose in motion, in the file's own axes and unit of length.

    `rotations` turn each joint relative to its parent; `offsets` lead from the parent to the joint
    while all rotations are the identity. `positions` of some joints, of the root always, stand in
    for these over time: the root's in the world, others' in their parents' frames. Leaves may be
    mere ends of bones.
    """

    fps: float
    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Float[Tensor, "J 3"]
    rotations: Float[Tensor, "F J 3 3"]
    positions: dict[int, Float[Tensor, "F 3"]]  # by joint


def resample(motion: BodyMotion, fps: float, start: float, seconds: float) -> BodyMotion:
    """Cut out `seconds` from `start` on and show them at another frame rate.

    Rotations turn along the shorter arc between frames, places move in straight lines. A motion
    that ends earlier gives fewer frames, at least one.

    Raises:
        ValueError: if the motion ends before `start`.
    """
    if start > motion.seconds:
        raise ValueError(f"the motion lasts {motion.seconds:.2f} s, it cannot start at {start:g} s")
    length = min(seconds, motion.seconds - start)
    count = math.floor(length * fps + 1e-6) + 1  # a frame that is late by rounding still counts
    numbers = (start + torch.arange(count, dtype=torch.float64) / fps) * motion.fps
    turns = torch.cat([motion.global_orient[:, None], motion.body_pose], 1)
    known = torch.arange(len(turns), dtype=torch.float64)
    turned, transl = interpolated(turns, motion.transl, known, numbers)
    return BodyMotion(fps=fps, global_orient=turned[:, 0], body_pose=turned[:, 1:], transl=transl)
