"""A clip of a soft bright ball, with its true blur, for tests of blur and its scores."""

import numpy as np
import torch

from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.pipeline.blur import BlurParams

FRAMES, HEIGHT, WIDTH, FPS = 12, 36, 48, 60.0
PLAIN = BlurParams(frames="interpolated", factor=4, window=9, averaging_space="srgb")


def picture(time: float) -> np.ndarray:
    """A soft bright ball with its matte, at `time` frames; it moves 2 pixels a frame."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    squared = (columns - 10 - 2 * time) ** 2 + (rows - 18) ** 2
    alpha = np.exp(-squared / 50)[..., None]
    front = np.stack([230 + 0 * rows, 120 + 3 * rows, 40 + 4 * rows], -1)
    return np.rint(np.concatenate([alpha * front, 255 * alpha], -1)).astype(np.uint8)


def make_clip(true_window: int = 9, recorded: tuple[int, ...] = (1,)) -> Clip:
    """Camera 1 trains; the true blur is of `true_window` quarter frames."""
    stack = torch.from_numpy(np.stack([picture(frame) for frame in range(FRAMES)]))
    half = true_window // 2
    reach = -(-half // 4)
    kept = tuple(range(reach, FRAMES - reach))
    sums = [
        np.mean([picture(frame + step / 4) for step in range(-half, half + 1)], 0) for frame in kept
    ]
    true = torch.from_numpy(np.rint(sums).astype(np.uint8))
    K = torch.tensor([[50.0, 0, 24], [0, 50, 18], [0, 0, 1]])
    cameras = Cameras(
        Ks=K.expand(3, 3, 3).clone(),
        viewmats=torch.eye(4).expand(3, 4, 4).clone(),
        distortion=torch.zeros(3, 5),
        sizes=torch.tensor([[WIDTH, HEIGHT]] * 3),
        names=("one", "two", "three"),
    )
    poses = Poses(
        betas=torch.zeros(2),
        global_orient=torch.zeros(FRAMES, 3),
        body_pose=torch.zeros(FRAMES, 3, 3),
        transl=torch.arange(FRAMES)[:, None].expand(FRAMES, 3).float(),
    )
    return Clip(
        frames=stack[..., :3].expand(len(recorded), -1, -1, -1, -1).contiguous(),
        mattes=stack[..., 3].expand(len(recorded), -1, -1, -1).contiguous(),
        recorded=recorded,
        train_camera=1,
        cameras=cameras,
        timestamps=torch.arange(FRAMES) / FPS,
        blurred=False,
        exposure=None,
        averaging_space="srgb",
        held_out_from=9,
        initial=poses,
        exact=None,
        true_blur_srgb=true[..., :3].contiguous(),
        true_blur_linear=None,
        true_blur_mattes=true[..., 3].contiguous(),
        frame_indices=kept,
        true_blur_exposure=true_window / (4 * FPS),
    )


def changed(params: BlurParams, **values: object) -> BlurParams:
    return BlurParams(**{**params.model_dump(), **values})
