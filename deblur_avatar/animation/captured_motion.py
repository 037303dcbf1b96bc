"""Captured motion: the one a person was filmed in, for any avatar to be shown in.

Frames may be unevenly spaced; what comes out is at an even rate, upright on the stage of
`stage.py`.
"""

from dataclasses import replace

import torch

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.animation.stage import Stage
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle


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
    stage_from_world = stage.world_from_stage.T
    turned = stage_from_world @ axis_angle_to_matrix(filmed.global_orient)
    staged = replace(
        filmed,
        global_orient=matrix_to_axis_angle(turned),
        transl=filmed.transl @ stage.world_from_stage,
    )
    shown = staged.at_times(times, wanted)
    return BodyMotion(
        fps=fps,
        global_orient=shown.global_orient,
        body_pose=shown.body_pose,
        transl=shown.transl,
    )
