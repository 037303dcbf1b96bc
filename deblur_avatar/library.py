"""The library: an avatar loaded from its folder, posed and animated without the footage.

`deblur_avatar/__init__.py` lists all names that are meant for callers; docs/library.md shows them.
"""

import math
from collections.abc import Iterable
from pathlib import Path

import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.animation.motion_files import read_motion
from deblur_avatar.animation.showing import plan_shot, render_shot
from deblur_avatar.animation.stage import stage_of
from deblur_avatar.artifacts.avatar import Avatar
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.cameras import look_at

CAMERA_DISTANCE = 4.0  # metres from the person to the camera of `animate`
MARGIN = 0.06  # around the person in `animate`, as a share of the picture


def load_avatar(avatar: Path | str, body: Path | str, device: str = "cpu") -> AvatarModel:
    """Load a fitted avatar.

    Args:
        avatar: folder that a stage wrote, `data/fusion/<run>/avatar`, say.
        body: folder of the body that it was fitted on, `data/body/anny`, say.
        device: torch's name of where to compute.

    Raises:
        ArtifactError: if one of them is not there, damaged or not of the other.
    """
    return avatar_from_artifact(
        Avatar.load(Path(avatar)), Body.load(Path(body)), torch.device(device)
    )


def rest_pose(model: AvatarModel, frames: int = 1) -> Poses:
    """The T-pose, the pelvis at the origin, facing +Z; replace what should move."""
    joints = len(model.body.parents)
    still = Poses(
        betas=model.betas.cpu(),
        global_orient=torch.zeros(frames, 3),
        body_pose=torch.zeros(frames, joints - 1, 3),
        transl=torch.zeros(frames, 3),
    )
    pelvis = posed(model.body, still).joints[:, 0]
    return Poses(**(vars(still) | {"transl": -pelvis}))


def animate(
    model: AvatarModel,
    motion: str | Path,
    *,
    fps: float = 24.0,
    start: float = 0.0,
    seconds: float = 8.0,
    size: int = 384,
    turns: float = 0.0,
    travel: float = 0.0,
) -> UInt8[Tensor, "F H W 3"]:
    """Render an avatar doing a motion, seen from the front; sRGB frames of `size` pixels squared.

    Args:
        model: whom to show.
        motion: an AMASS `.npz`, an AIST++ `.pkl` or a `.bvh` file, or `builtin:<name>`.
        fps: frames a second, above 0.
        start: seconds into the motion, 0 or more.
        seconds: how long, 0 or more; a motion that ends earlier gives fewer frames.
        size: of the pictures, pixels, 1 or more.
        turns: how often the person turns in all, so that every side is seen.
        travel: share of the motion's steps that is kept; 0 is on the spot.

    Raises:
        ConfigError: if there is no such motion, it cannot be shown, or a number is out of range.
        ArtifactError: if the motion's file is damaged.
    """
    _in_range("fps", fps, fps > 0, "above 0")
    _in_range("start", start, start >= 0, "0 or more")
    _in_range("seconds", seconds, seconds >= 0, "0 or more")
    _in_range("size", size, size >= 1, "1 or more")
    betas = model.betas.cpu()
    steps = read_motion(str(motion), model.body, betas, fps=fps, start=start, seconds=seconds)
    eye, up = torch.tensor([0.0, 0.0, CAMERA_DISTANCE]), torch.tensor([0.0, 1.0, 0.0])
    K = torch.tensor([[2.0 * size, 0, size / 2], [0, 2.0 * size, size / 2], [0, 0, 1]])
    viewmat = look_at(eye, torch.zeros(3), up)
    joints = posed(model.body, rest_pose(model)).joints
    try:
        stage = stage_of(joints, viewmat, world_is_a_cameras=False)
        shot = plan_shot(
            steps, model.body, betas, stage, K, viewmat,
            size=size, margin=MARGIN, turns=turns, travel=travel,
        )  # fmt: skip
    except ValueError as error:
        raise ConfigError(f"{motion}: {error}") from None
    return render_shot(model, shot, _silent)


def _in_range(name: str, value: float | int, inside: bool, wanted: str) -> None:
    if not (inside and math.isfinite(value)):
        raise ConfigError(f"{name}: wanted a finite number, {wanted}, got {value}")


def _silent(items: Iterable[int], description: str) -> Iterable[int]:
    return items
