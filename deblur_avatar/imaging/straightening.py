"""Undistortion of a clip: every picture of every camera as a pinhole camera would have taken it."""

from dataclasses import replace

import torch
from torch import Tensor

from deblur_avatar.artifacts.clip import BlurryClip
from deblur_avatar.imaging.resampling import undistort


def straightened(clip: BlurryClip) -> BlurryClip:
    """Take lens distortion out of all pictures of a clip; without distortion the very clip.

    Each camera keeps its intrinsics and its picture's size; what the lens did not see is black.
    """
    cameras = clip.cameras
    if not cameras.distortion.any():
        return clip

    def straight(images: Tensor, camera: int) -> Tensor:
        return undistort(images, cameras.Ks[camera], cameras.distortion[camera])

    def all_straight(stacks: Tensor) -> Tensor:
        rows = zip(stacks, clip.recorded, strict=True)
        return torch.stack([straight(stack, camera) for stack, camera in rows])

    def train_straight(images: Tensor | None) -> Tensor | None:
        return None if images is None else straight(images, clip.train_camera)

    return replace(
        clip,
        frames=all_straight(clip.frames),
        mattes=None if clip.mattes is None else all_straight(clip.mattes),
        sharp_frames=train_straight(clip.sharp_frames),
        sharp_mattes=train_straight(clip.sharp_mattes),
        cameras=replace(cameras, distortion=torch.zeros_like(cameras.distortion)),
    )
