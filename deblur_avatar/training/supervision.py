"""Which renders of an exposure are compared with its frame, and with what weight.

Conventions. C is the sharp render, B the mean over the virtual instants, F their blend by the
fusion network. Iterations are the paper's 15,000. A supervision is named by what it compares; the
authors' released code compares several at once and changes its mind on the way.
"""

from typing import Final, Literal

from deblur_avatar.geometry.rotations import (
    quat_conjugate,
    quat_multiply,
    quat_to_axis_angle,
)
from deblur_avatar.motion.trajectory import Trajectory

Mask = Literal["mean", "union", "centre"]  # which coverage is compared with the matte
RELEASED: Final = "released"
STILL_SHARE: Final = 0.1  # of the frames count as still, those that turn least (released code)
MOVING_WEIGHT: Final = 0.1  # of C in frames that move
BOTH_UNTIL: Final = 5000  # B is compared too


def shares(supervision: str, iteration: float, still: bool, blended: bool) -> dict[str, float]:
    """Weights of the renders: sharp (C), mean (B), fused (F).

    Args:
        supervision: by name.
        iteration: of the paper's 15,000.
        still: whether the frame counts as still.
        blended: whether there is a fusion network: in the last stage, from iteration 7,000.

    Source: the released code's schedule of losses (xianrui-luo/deblur_avatar, train.py). After
    5,000 iterations its B is compared no more, and after 7,000 it is part of F without gradient.
    """
    if supervision != RELEASED:
        return {supervision: 1.0}
    if iteration < BOTH_UNTIL:
        return {"sharp": 1.0, "mean": 1.0}
    weights = {"sharp": 1.0 if still else MOVING_WEIGHT}
    return weights | ({"fused": 1.0} if blended else {})


def still_frames(trajectory: Trajectory, frames: list[int]) -> set[int]:
    """The tenth of the frames whose joints turn least between the ends of the exposure."""
    turns = {}
    for frame in frames:
        quats = trajectory(frame).quats.detach()
        between = quat_to_axis_angle(quat_multiply(quat_conjugate(quats[0]), quats[-1]))
        turns[frame] = float(between.norm(dim=-1).max())
    order = sorted(frames, key=lambda frame: turns[frame])
    return set(order[: max(round(STILL_SHARE * len(frames)), 1)])
