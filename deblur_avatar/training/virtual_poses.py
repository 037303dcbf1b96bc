"""How many virtual poses each exposure needs: as many as its fastest joint travels far.

Conventions. Travel is the length of a joint's path in the training camera's picture while the
shutter is open, in pixels.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.bodies.posed_body import joints_from_rotations
from deblur_avatar.geometry.cameras import project
from deblur_avatar.motion.clip import ClipMotion
from deblur_avatar.motion.params import TrajectoryParams
from deblur_avatar.motion.trajectory import Instants, Trajectory

SAMPLES = 9  # instants along each path


def choose_counts(
    trajectory: Trajectory, observations: Observations, params: TrajectoryParams
) -> None:
    """Give each exposure of a clip's trajectory a virtual pose per `pixels_per_pose` of travel."""
    if not isinstance(trajectory, ClipMotion) or params.pixels_per_pose == 0:
        return
    travel = farthest_travel(trajectory, observations)
    counts = (travel / params.pixels_per_pose).ceil().long().clamp(1, params.virtual_poses)
    trajectory.take(counts)


def farthest_travel(trajectory: Trajectory, observations: Observations) -> Float[Tensor, " F"]:
    """How far the joint that travels farthest gets in each exposure, pixels."""
    u = torch.linspace(0, 1, SAMPLES).to(trajectory.u)
    with torch.no_grad():
        frames = [trajectory.at(index, u) for index in range(len(observations.timestamps))]
        return torch.stack([_travel(frame, observations) for frame in frames])


def _travel(frame: Instants, observations: Observations) -> Float[Tensor, ""]:
    camera = observations.train_camera
    betas = observations.poses.betas.to(frame.transl)
    joints = joints_from_rotations(observations.body, betas, frame.rotations, frame.transl)
    cameras = observations.cameras
    pixels, _ = project(joints, cameras.Ks[camera].to(joints), cameras.viewmats[camera].to(joints))
    return pixels.diff(dim=0).norm(dim=-1).sum(0).amax()
