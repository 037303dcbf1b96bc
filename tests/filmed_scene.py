"""A scene with a truth: the capsule person seen by the camera that filmed her and by two others."""

import dataclasses
from dataclasses import dataclass

import torch

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.geometry.cameras import look_at
from deblur_avatar.motion.frame import FrameMotion

EYES = ((0.0, 0.0, 4.0), (2.8, 0.0, 2.8), (-2.8, 0.5, 2.8))
CLIP_SIZE = 48  # pixels; observations are half as large


@dataclass(frozen=True)
class Scene:
    """What `evaluate` reads, of an avatar that is the truth itself."""

    observations: Observations
    reference: Reference
    avatar: Avatar
    motion: Motion


def film(model: AvatarModel, filmed: Observations) -> Scene:
    """Make a scene of the person in `filmed`, 8 frames of one camera.

    Frames 0 to 4 are trained on but for 2, which validates; 5 to 7 are held out.
    """
    cameras = _cameras(CLIP_SIZE)
    halved = cameras.Ks.clone()
    halved[:, :2] /= 2
    observations = dataclasses.replace(
        filmed,
        cameras=dataclasses.replace(cameras, Ks=halved, sizes=cameras.sizes // 2),
        crops=torch.tensor([[0.0, 0, CLIP_SIZE, CLIP_SIZE]]).repeat(3, 1),
        frame_indices=tuple(range(10, 18)),
        train=(0, 1, 3, 4),
        validation=(2,),
    )
    with torch.no_grad():
        motion = FrameMotion(filmed.poses).to_artifact(filmed.poses.betas, observations.timestamps)
    return Scene(
        observations=observations,
        reference=_reference(model, filmed.poses, cameras, observations),
        avatar=model.to_artifact(7),
        motion=motion,
    )


def _cameras(size: int) -> Cameras:
    up, centre = torch.tensor([0.0, 1.0, 0.0]), torch.zeros(3)
    K = torch.tensor([[1.6 * size, 0, size / 2], [0, 1.6 * size, size / 2], [0, 0, 1]])
    return Cameras(
        Ks=K.repeat(3, 1, 1),
        viewmats=torch.stack([look_at(torch.tensor(eye), centre, up) for eye in EYES]),
        distortion=torch.zeros(3, 5),
        sizes=torch.tensor([[size, size]] * 3),
        names=("front", "left", "right"),
    )


def _reference(
    model: AvatarModel, poses: Poses, cameras: Cameras, observations: Observations
) -> Reference:
    """Every frame from both test cameras; the motion is sampled four times a frame."""
    images, mattes = [], []
    for camera in (1, 2):
        drawn = render_avatar(model, poses, cameras.camera(camera))
        images.append(drawn[0])
        mattes.append(drawn[1])
    frames = torch.tensor(observations.frame_indices).repeat(2)
    times = torch.linspace(0, float(observations.timestamps[-1]), 29)
    share = times * 60
    low = share.floor().long().clamp(max=6)
    part = (share - low)[:, None]
    turned = poses.body_pose[low] + part[..., None] * (
        poses.body_pose[low + 1] - poses.body_pose[low]
    )
    return Reference(
        images=(torch.cat(images) * 255).round().to(torch.uint8),
        mattes=(torch.cat(mattes) * 255).round().to(torch.uint8),
        seen=None,
        camera_indices=torch.tensor([1, 2]).repeat_interleave(8),
        frame_indices=frames,
        novel_pose=(frames >= 15).long(),
        background=(0.0, 0.0, 0.0),
        motion_times=times,
        motion=Poses(
            betas=poses.betas,
            global_orient=poses.global_orient[low],
            body_pose=turned,
            transl=poses.transl[low] + part * (poses.transl[low + 1] - poses.transl[low]),
        ),
    )
