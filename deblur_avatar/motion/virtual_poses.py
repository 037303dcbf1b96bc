"""Number of virtual poses of an exposure, from how far the body travels in the picture.

Conventions. Travel is the length of a joint's path in the training camera's picture while the
shutter is open, in pixels.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.bodies.posed_body import joints_from_rotations
from deblur_avatar.geometry.cameras import project
from deblur_avatar.motion.trajectory import Instants, Trajectory

SAMPLES = 9  # instants along each path; not a parameter: straight pieces are as long by then


def farthest_travel(trajectory: Trajectory, observations: Observations) -> Float[Tensor, " F"]:
    """How far the joint that travels farthest gets in each exposure, pixels."""
    u = torch.linspace(0, 1, SAMPLES).to(trajectory.u)
    with torch.no_grad():
        frames = [trajectory.at(index, u) for index in range(len(observations.timestamps))]
        return torch.stack([_travel(frame, observations) for frame in frames])


def _travel(frame: Instants, observations: Observations) -> Float[Tensor, ""]:
    camera = observations.camera.to(frame.transl)
    betas = observations.poses.betas.to(frame.transl)
    joints = joints_from_rotations(observations.body, betas, frame.rotations, frame.transl)
    pixels, _ = project(joints, camera.K, camera.viewmat)
    return pixels.diff(dim=0).norm(dim=-1).sum(0).amax()
