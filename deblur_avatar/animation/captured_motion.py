"""Captured motion: the one a person was filmed in, for any avatar to be shown in.

Frames may be unevenly spaced; what comes out is at an even rate, upright on the stage of
`stage.py`.
"""

import torch

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.animation.stage import Stage
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.geometry.rotations import (
    axis_angle_to_matrix,
    matrix_to_axis_angle,
    turn_between,
)


def captured_motion(
    motion: Motion, stage: Stage, fps: float, start: float, seconds: float
) -> BodyMotion:
    """Take a fitted motion from the world it was filmed in to the stage.

    Args:
        motion: of every frame; its centre poses are used.
        stage: where it was filmed.
        fps: frames a second wanted.
        start: seconds after the first frame.
        seconds: how long; a motion that ends earlier gives fewer frames.

    Raises:
        ValueError: if the motion ends before `start`.
    """
    filmed, times = motion.centre, motion.timestamps.double()
    times = times - times[0]
    if start > float(times[-1]):
        raise ValueError(f"the motion lasts {float(times[-1]):.2f} s, it cannot start at {start:g}")
    last = min(start + seconds, float(times[-1]))
    wanted = start + torch.arange(int((last - start) * fps + 1e-6) + 1).double() / fps
    after = torch.searchsorted(times, wanted).clamp(1, max(len(times) - 1, 1))
    before = after - 1
    after = after.clamp(max=len(times) - 1)
    gap = (times[after] - times[before]).clamp(min=1e-9)
    share = ((wanted - times[before]) / gap).clamp(0, 1).float()
    stage_from_world = stage.world_from_stage.T
    orient = matrix_to_axis_angle(stage_from_world @ axis_angle_to_matrix(filmed.global_orient))
    place = filmed.transl @ stage.world_from_stage
    return BodyMotion(
        fps=fps,
        global_orient=turn_between(orient[before], orient[after], share),
        body_pose=turn_between(filmed.body_pose[before], filmed.body_pose[after], share),
        transl=torch.lerp(place[before], place[after], share[:, None]),
    )
