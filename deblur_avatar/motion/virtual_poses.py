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
from deblur_avatar.geometry.rotations import quat_to_matrix
from deblur_avatar.motion.trajectory import Trajectory

SAMPLES = 9  # instants along each path; not a parameter: straight pieces are as long by then


def farthest_travel(trajectory: Trajectory, observations: Observations) -> Float[Tensor, " F"]:
    """How far the joint that travels farthest gets in each exposure, pixels."""
    u = torch.linspace(0, 1, SAMPLES).to(trajectory.u)
    with torch.no_grad():
        frames = [trajectory.at(index, u) for index in range(len(observations.timestamps))]
        transl = torch.stack([frame.transl for frame in frames])
        # All exposures at once: one by one, joints and pixels take four times as long.
        rotations = quat_to_matrix(torch.stack([frame.quats for frame in frames]))
        betas = observations.poses.betas.to(transl)
        joints = joints_from_rotations(observations.body, betas, rotations, transl)
        camera = observations.camera.to(transl)
        pixels, _ = project(joints, camera.K, camera.viewmat)
        return pixels.diff(dim=1).norm(dim=-1).sum(1).amax(1)
