"""Given poses: estimated by another program, brought into the camera's own axes.

A `.npz` with, for each of F frames of the footage, `global_orient` [F,3], `body_pose` [F,23,3] or
[F,69] (or both in one, `poses` [F,72]), `transl` [F,3], and one `betas` [B]: SMPL's meaning,
axis-angle, radians, metres. Without more they are in the camera's axes of each frame (OpenCV's).
With `viewmats` [F,4,4] or [4,4], world to camera, they are in that world. A frame without
a pose has NaN for every number of it, and gets one from the frames around (`missing_poses`).

A camera that moves past a person who stands shows the same pictures as one that stands before a
person who moves. The background is taken away, so nothing else is left of the camera's way, and
one still camera with the body moving before it explains every frame exactly.
"""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.cameras import check_cameras
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from deblur_avatar.readers.foreign_arrays import load_npz
from deblur_avatar.sources.missing_poses import fill_missing, without_pose

KEYS = ("poses", "global_orient", "body_pose", "transl", "betas", "viewmats")
MAX_VALUE = 1e6  # of an angle or a place


def read_poses(path: Path, numbers: tuple[int, ...], total: int | None, body: Body) -> Poses:
    """Poses of some frames before a still camera at the origin.

    Args:
        path: the `.npz`.
        numbers: frames wanted.
        total: frames of the footage, where known.
        body: whose poses they are.

    Raises:
        ArtifactError: if the file is missing or damaged, or an array is of the wrong shape; names
            the array, what was wanted and what came.
    """
    arrays = _arrays(path)
    if (
        arrays.get("poses", np.zeros(0)).size
        and not {"global_orient", "body_pose"} <= arrays.keys()
    ):
        whole = arrays["poses"].reshape(len(arrays["poses"]), -1)
        arrays["global_orient"], arrays["body_pose"] = whole[:, :3], whole[:, 3:]
    joints, shapes = len(body.parents) - 1, body.shape_dirs.shape[2]
    frames = total if total is not None else len(arrays.get("transl", ()))
    if frames <= max(numbers):
        raise ArtifactError(f"{path}: transl is of {frames} frames, wanted {max(numbers) + 1}")
    orient = _shaped(arrays, "global_orient", (frames, 3), path)
    pose = _shaped(arrays, "body_pose", (frames, joints, 3), path)
    transl = _shaped(arrays, "transl", (frames, 3), path)
    turns = torch.cat([orient[:, None], pose], dim=1)
    bare = without_pose(turns, transl)
    for name, value in (("global_orient", orient), ("body_pose", pose), ("transl", transl)):
        _check_numbers(value[~bare], name, path)
    # What lies outside the frames wanted may be missing, and does not count.
    first, last = min(numbers), max(numbers) + 1
    turns, transl = fill_missing(turns[first:last], transl[first:last], str(path))
    betas = arrays.get("betas", np.zeros(0)).reshape(-1)
    if len(betas) != shapes:
        raise ArtifactError(
            f"{path}: betas are {len(betas)} numbers, the body has {shapes}; shape numbers are of "
            "one body model: name that model under bodies, or change shape_components"
        )
    rows = [number - first for number in numbers]
    try:
        poses = Poses(
            betas=torch.from_numpy(betas).float(),
            global_orient=turns[rows, 0],
            body_pose=turns[rows, 1:],
            transl=transl[rows],
        )
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from None
    if "viewmats" not in arrays:
        return poses
    cameras = _viewmats(arrays["viewmats"], frames, path)[list(numbers)]
    try:
        check_cameras(torch.eye(3).repeat(len(cameras), 1, 1), cameras)
    except ValueError as error:
        raise ArtifactError(f"{path}: {error}") from None
    return before_still_camera(poses, cameras, shaped_joints(body, poses.betas)[0])


def _viewmats(viewmats: np.ndarray, frames: int, path: Path) -> Float[Tensor, "F 4 4"]:
    """Every frame's camera; one for all is repeated."""
    if viewmats.shape == (4, 4):
        viewmats = np.broadcast_to(viewmats, (frames, 4, 4)).copy()
    return _checked({"viewmats": viewmats}, "viewmats", (frames, 4, 4), path)


def before_still_camera(
    poses: Poses, viewmats: Float[Tensor, "F 4 4"], pelvis: Float[Tensor, " 3"]
) -> Poses:
    """Give the camera's way to the body: the same pictures from a camera at the world's origin.

    Args:
        poses: in the world that the cameras stand in.
        viewmats: world to camera, of each frame.
        pelvis: at rest; bodies turn about it.
    """
    turn = viewmats[:, :3, :3]
    orient = turn @ axis_angle_to_matrix(poses.global_orient)
    place = (turn @ (poses.transl + pelvis)[..., None])[..., 0] + viewmats[:, :3, 3]
    return Poses(
        betas=poses.betas,
        global_orient=matrix_to_axis_angle(orient),
        body_pose=poses.body_pose,
        transl=place - pelvis,
    )


def _arrays(path: Path) -> dict[str, np.ndarray]:
    if not path.is_file():
        raise ArtifactError(f"no poses {path}; check clip.poses")
    try:
        arrays = load_npz(path, KEYS)
    except ArtifactError as error:
        raise ArtifactError(f"{path} is no .npz of numbers: {error}") from None
    for name, array in arrays.items():
        if array.dtype.kind not in "fiu" or not array.ndim:
            raise ArtifactError(
                f"{path} is no .npz of numbers: {name} is {array.dtype} {list(array.shape)}"
            )
    return {name: array.astype(np.float64) for name, array in arrays.items()}


def _checked(
    arrays: dict[str, np.ndarray], name: str, shape: tuple[int, ...], path: Path
) -> Tensor:
    value = _shaped(arrays, name, shape, path)
    _check_numbers(value, name, path)
    return value


def _check_numbers(value: Tensor, name: str, path: Path) -> None:
    if not bool((value.abs() <= MAX_VALUE).all()):
        raise ArtifactError(
            f"{path}: {name} holds values that are not finite or over {MAX_VALUE:g}"
        )


def _shaped(arrays: dict[str, np.ndarray], name: str, shape: tuple[int, ...], path: Path) -> Tensor:
    if name not in arrays:
        raise ArtifactError(
            f"{path} has no {name}, it has {', '.join(sorted(arrays)) or 'nothing'}"
        )
    value = arrays[name]
    if len(value) != shape[0] or value.size != int(np.prod(shape)):
        raise ArtifactError(
            f"{path}: {name} is {list(value.shape)}, wanted {list(shape)}: one row for every frame "
            "of the footage"
        )
    return torch.from_numpy(value.reshape(shape)).float()
