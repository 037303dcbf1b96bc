"""Parameters of a trajectory."""

from typing import Literal

from deblur_avatar.config.section import (
    Count,
    NonNegative,
    Params,
    Positive,
)


class TrajectoryParams(Params):
    """How the body moves while the shutter is open, and what the frame is compared with."""

    motion: Literal["fixed", "frame", "pair", "cubic", "learned", "released", "clip"]
    virtual_poses: Count  # at most, where `pixels_per_pose` says how many
    pixels_per_pose: (
        NonNegative  # clip: farthest travel in the picture per virtual pose; 0: always all
    )
    shutter: Literal["given", "estimated"]  # clip: how long it was open
    quadrature: Literal["endpoints", "midpoints"]
    start_noise: NonNegative  # pair: radians; parts start from end
    knot_frames: Positive  # clip: frames between two knots of the trajectory, at most
    finest_knot_frames: Positive  # clip: and at least, where given poses ask for finer knots
    smoothness: NonNegative  # clip: of the first trajectory, against closeness to the given poses
    supervision: Literal["sharp", "mean", "released"]
    mask: Literal["mean", "union", "centre"]
