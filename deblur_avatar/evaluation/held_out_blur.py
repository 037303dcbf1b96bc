"""Reconstructions of held-out blurred frames, which is what scores an avatar without ground truth.

A frame is explained if the avatar, rendered over the exposure and averaged, looks like it;
rendered at the exposure's middle, the same avatar shows what it would have been without blur.
"""

from typing import Any

import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.motion import Motion
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.render import as_filmed, render_avatar
from deblur_avatar.evaluation.reblur import poses_of_exposure
from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.imaging.metrics import psnr

Files = dict[str, UInt8[Tensor, "H W 3"]]


def reconstruct_held_out(
    avatar: Avatar,
    motion: Motion,
    observations: Observations,
    max_frames: int,
    device: torch.device,
) -> tuple[Files, list[dict[str, Any]]]:
    """Render some validation frames (training frames if none is set aside), evenly spaced in time.

    Returns:
        Pictures by file name, and for each frame its entry in `views.json`: the names of its
        `render`, its `averaged` render and the `blurred` frame, and the PSNR of the latter two.
    """
    model = avatar_from_artifact(avatar, observations.body, device)
    frames = observations.validation or observations.train
    frames = tuple(f for f in frames if observations.weights[f] > 0) or frames
    files: Files = {}
    index = []
    name = observations.cameras.names[observations.train_camera]
    for position in evenly_spaced(frames, max_frames):
        exposed = poses_of_exposure(observations.body, motion, position, observations.train)
        middle = exposed.at([len(exposed.transl) // 2])
        render = _render(model, observations, middle, position, average=False)
        averaged = _render(model, observations, exposed, position, average=True)
        blurred = observations.frames[position]
        frame = observations.frame_indices[position]
        names = {kind: f"{frame:04d}-{kind}.png" for kind in ("render", "averaged", "blurred")}
        pictures = {"render": render, "averaged": averaged, "blurred": blurred}
        files |= {names[kind]: picture for kind, picture in pictures.items()}
        pair = [
            observations.comparable_part(p.float() / 255, position) for p in (averaged, blurred)
        ]
        score = psnr(pair[0][None], pair[1][None])
        entry = {"camera": name, "frame": frame, "novel_pose": False, "psnr": float(score)}
        index.append({**entry, **names})
    return files, index


def _render(
    model: AvatarModel, observations: Observations, poses: Poses, position: int, *, average: bool
) -> UInt8[Tensor, "H W 3"]:
    image, alpha = render_avatar(
        model,
        poses,
        observations.camera,
        frame=min(observations.train, key=lambda index: abs(index - position)),
        average=average,
    )
    shown = as_filmed(observations, position, image[0].cpu(), alpha[0].cpu())
    return (shown.clamp(0, 1) * 255).round().to(torch.uint8)
