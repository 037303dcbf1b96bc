"""Someone who turned round on the spot, before cameras."""

import math

import torch

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.animation.stage import Stage, stage_of
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.geometry.cameras import look_at
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

PERSON = torch.tensor([1.0, 2.0, 1.1])  # in a world with +Z up
UPRIGHT = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # +Y to +Z
VIEW = look_at(torch.tensor([5.0, 5.0, 1.6]), PERSON, torch.tensor([0.0, 0.0, 1.0]))
CAMERA_WORLD = torch.eye(4)  # +Y down, +Z away from the camera
K = torch.tensor([[500.0, 0, 300], [0, 500, 200], [0, 0, 1]])


def turning_person():
    """She leans forth and back a little."""
    frames = 20
    angle = torch.linspace(0, 6.2832, frames + 1)[:-1]
    lean = 0.2 * torch.sin(3 * angle)
    zero = torch.zeros(frames)
    turned = axis_angle_to_matrix(torch.stack([zero, angle, zero], 1))
    leaned = axis_angle_to_matrix(torch.stack([lean, zero, zero], 1))
    return Poses(
        betas=torch.tensor([1.0, 0.0]),
        global_orient=matrix_to_axis_angle(UPRIGHT @ turned @ leaned),
        body_pose=torch.zeros(frames, 23, 3),
        transl=PERSON.repeat(frames, 1),
    )


def in_camera_world(filmed, pitch, lean=0.0):
    """The same person before a camera that looks down by `-pitch`, all leaning sideways."""
    level = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # +Z up to +Y down
    turns = torch.tensor([[math.radians(-pitch), 0, 0], [0, 0, math.radians(lean)]])
    pitched, rolled = axis_angle_to_matrix(turns)
    orient = rolled @ pitched @ level @ axis_angle_to_matrix(filmed.global_orient)
    return Poses(
        betas=filmed.betas, global_orient=matrix_to_axis_angle(orient),
        body_pose=filmed.body_pose, transl=torch.tensor([0.3, 0.2, 5.0]).expand(len(orient), 3),
    )  # fmt: skip


def stage_before(body, filmed, viewmat) -> Stage:
    """The stage of one camera, whose world is its own where that is `CAMERA_WORLD`."""
    own = viewmat is CAMERA_WORLD
    return stage_of(posed(body, filmed).joints, viewmat, world_is_a_cameras=own)


def standing(frames=6, heading=0.0, **changes):
    orient = torch.tensor([0.0, heading, 0.0]).repeat(frames, 1)
    content = {
        "fps": 10.0, "global_orient": orient, "body_pose": torch.zeros(frames, 23, 3),
        "transl": torch.zeros(frames, 3),
    }  # fmt: skip
    return BodyMotion(**(content | changes))
