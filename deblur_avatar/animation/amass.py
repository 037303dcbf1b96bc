"""AMASS sequences (`.npz`): SMPL poses from optical motion capture.

Conventions. `poses` holds axis-angles, 3 for each joint: the root, 21 joints of the body, then what
the model has besides (SMPL-H's hands, SMPL-X's face and hands), which is left out. The world has +Z
up, metres.

Source: Mahmood et al., "AMASS", ICCV 2019, and its files' documented keys.
"""

from pathlib import Path

import numpy as np
import torch

from deblur_avatar.animation.driving_motion import BodyMotion
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from deblur_avatar.readers.foreign_arrays import load_npz

BODY = 66  # numbers of the root and the 21 joints that all models of the family share
RATES = ("mocap_framerate", "mocap_frame_rate")  # SMPL-H files and SMPL-X files
FASTEST = 1e6  # frames a second
MAX_VALUE = 1e6  # of an angle or a place
UPRIGHT_FROM_AMASS = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # +Z to +Y
WIDTHS = (66, 72, 156, 165)  # the body alone, SMPL, SMPL-H, SMPL-X


def read_amass(path: Path) -> BodyMotion:
    """Read one sequence; hands stay straight, the file's own shape is left out.

    Raises:
        ArtifactError: if it is missing, damaged or lacks a key; says which.
    """
    content = load_npz(path, {"poses", "trans", *RATES})
    poses, trans = content.get("poses"), content.get("trans")
    rate = next((content[key] for key in RATES if key in content), None)
    if poses is None or trans is None or rate is None:
        raise ArtifactError(
            f"{path} is not an AMASS sequence: wanted poses, trans, mocap_framerate, "
            f"got {', '.join(content) or 'nothing'}"
        )
    if poses.ndim != 2 or poses.shape[1] not in WIDTHS or trans.shape != (len(poses), 3):
        raise ArtifactError(
            f"{path}: poses must be [F, {' | '.join(map(str, WIDTHS))}] and trans [F, 3], "
            f"got {poses.shape} and {trans.shape}"
        )
    numbers = [array for array in (poses, trans, rate) if array.dtype.kind in "fiu"]
    if len(numbers) < 3 or not all(np.isfinite(array).all() for array in numbers):
        raise ArtifactError(f"{path}: poses, trans and mocap_framerate must be finite numbers")
    fps = float(rate.reshape(-1)[0]) if rate.size == 1 else 0.0
    if not 0 < fps <= FASTEST or len(poses) < 1:
        raise ArtifactError(
            f"{path}: wanted frames and a positive mocap_framerate, got {rate!s:.80} and "
            f"{len(poses)} frames (at most {FASTEST:g} a second are read)"
        )
    if max(abs(poses[:, :BODY]).max(), abs(trans).max()) > MAX_VALUE:
        raise ArtifactError(
            f"{path}: poses and trans must be radians and metres, under {MAX_VALUE:g}"
        )
    axis_angle = torch.from_numpy(poses[:, :BODY].astype(np.float32)).reshape(-1, BODY // 3, 3)
    root = UPRIGHT_FROM_AMASS @ axis_angle_to_matrix(axis_angle[:, 0])
    hands = axis_angle.new_zeros(len(axis_angle), 2, 3)
    return BodyMotion(
        fps=fps,
        global_orient=matrix_to_axis_angle(root),
        body_pose=torch.cat([axis_angle[:, 1:], hands], dim=1),
        transl=torch.from_numpy(trans.astype(np.float32)) @ UPRIGHT_FROM_AMASS.T,
    )
