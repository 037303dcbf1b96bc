"""AIST++ motions (`.pkl`): SMPL poses of street dances.

Conventions. `smpl_poses` [F,72] axis-angles of SMPL's 24 joints, `smpl_trans` [F,3] in the length
of a scaled body, `smpl_scaling` [1] of it; 60 frames a second, +Y up.

Source: Li et al., "AI Choreographer", ICCV 2021, and its published loader's description.
"""

from pathlib import Path

import numpy as np
import torch

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.errors import ArtifactError
from deblur_avatar.readers.foreign_arrays import load_arrays

FPS = 60.0  # of the data set
JOINTS = 24  # SMPL's
SMALLEST = 1e-6  # scale of a body
MAX_VALUE = 1e9  # of an angle or a place


def read_aist(path: Path) -> BodyMotion:
    """Read one dance; its places are divided by the body's scale, which makes them metres.

    Raises:
        ArtifactError: if it is missing, damaged, wants to run code, or lacks a key.
    """
    content = load_arrays(path)
    keys = ("smpl_poses", "smpl_trans", "smpl_scaling")
    if any(key not in content for key in keys):
        raise ArtifactError(
            f"{path} is not an AIST++ motion: wanted {', '.join(keys)}, "
            f"got {', '.join(content) or 'nothing'}"
        )
    try:
        poses, trans, scaling = (np.asarray(content[key], np.float32) for key in keys)
    except (TypeError, ValueError, OverflowError) as error:
        raise ArtifactError(f"{path}: {error}") from None
    frames = len(poses) if poses.ndim == 2 else 0
    if frames < 1 or poses.shape != (frames, 3 * JOINTS) or trans.shape != (frames, 3):
        raise ArtifactError(
            f"{path}: smpl_poses must be [F, {3 * JOINTS}] and smpl_trans [F, 3], "
            f"got {poses.shape} and {trans.shape}"
        )
    finite = np.isfinite(poses).all() and np.isfinite(trans).all() and np.isfinite(scaling).all()
    if scaling.size != 1 or not finite or not float(scaling.reshape(())) >= SMALLEST:
        raise ArtifactError(
            f"{path}: wanted finite numbers and a positive smpl_scaling, {SMALLEST:g} or more"
        )
    if max(abs(poses).max(), abs(trans).max()) > MAX_VALUE:
        raise ArtifactError(f"{path}: smpl_poses and smpl_trans must be under {MAX_VALUE:g}")
    axis_angle = torch.from_numpy(poses).reshape(frames, JOINTS, 3)
    return BodyMotion(
        fps=FPS,
        global_orient=axis_angle[:, 0],
        body_pose=axis_angle[:, 1:],
        transl=torch.from_numpy(trans / float(scaling.reshape(()))),
    )
