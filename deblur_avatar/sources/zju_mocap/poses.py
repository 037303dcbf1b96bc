"""ZJU-MoCap poses: SMPL as EasyMocap writes it, in our convention.

A file `new_params/<frame number>.npy` is a pickled dictionary: `poses` [1,72] (or [1,69], without
the root), `Rh` [1,3], `Th` [1,3], `shapes` [1,B]. The body X(poses, shapes) is turned about the
*origin*: V = R(Rh) X + Th. Ours turns about the pelvis J, so that transl = Th + R(Rh) J - J.
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed, shaped_joints
from deblur_avatar.errors import ArtifactError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from deblur_avatar.readers.foreign_arrays import load_npy, load_npy_files
from deblur_avatar.sources.folders import file_inside

logger = logging.getLogger(__name__)

PARAMETERS, VERTICES = "new_params", "new_vertices"
SAME_SHAPE = 1e-4  # by which shape numbers may differ between frames
MAX_VALUE = 1e6  # of an angle, a place or a shape number
NEAR_MM = 10.0  # mean distance from the vertices given, beyond which the body is another


def read_poses(root: Path, numbers: Sequence[int], body: Body) -> Poses:
    """Read the poses of the frames with these numbers; the first frame's shape is everyone's.

    Where the data set also gives the vertices, those of the first and last frame are compared with
    the body's, and a difference is logged: a body file of another gender or release does not fit.

    Raises:
        ArtifactError: if a frame's file is missing or damaged, or the body is not the one that the
            poses were fitted with.
    """
    if len(body.parents) != 24:
        raise ArtifactError(f"poses are of SMPL's 24 joints, the body has {len(body.parents)}")
    folder = root / PARAMETERS
    there = [number for number in numbers if (folder / f"{number}.npy").exists()]
    if len(there) < len(numbers):
        missing = next(number for number in numbers if number not in set(there))
        raise ArtifactError(
            f"{folder}: no {missing}.npy, {len(there)} of {len(numbers)} frames have parameters; "
            "keep clip.frames to those, or set clip.poses to none and preprocess.poses to estimated"
        )
    paths = [file_inside(root, f"{PARAMETERS}/{number}.npy") for number in numbers]
    rows = [_one_frame(*pair) for pair in zip(paths, load_npy_files(paths), strict=True)]
    if len({len(row[3]) for row in rows}) > 1:
        raise ArtifactError(
            f"{folder}: shapes are of as many numbers in every frame, these are not"
        )
    poses, turns, places, shapes = (torch.stack(column) for column in zip(*rows, strict=True))
    betas = _betas(shapes, body, folder)
    turn = axis_angle_to_matrix(turns)
    pelvis = shaped_joints(body, betas)[0]
    converted = Poses(
        betas=betas,
        global_orient=matrix_to_axis_angle(turn @ axis_angle_to_matrix(poses[:, 0])),
        body_pose=poses[:, 1:],
        transl=places + turn @ pelvis - pelvis,
    )
    _compare_vertices(root, numbers, body, converted)
    return converted


def _one_frame(path: Path, content: Any) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Poses [24,3], Rh [3], Th [3], shapes [B] of one frame."""
    keys = ("poses", "Rh", "Th", "shapes")
    if not isinstance(content, dict) or not set(keys) <= content.keys():
        found = ", ".join(content) if isinstance(content, dict) else "an array"
        raise ArtifactError(f"{path}: wanted {', '.join(keys)}, got {found}")
    try:
        poses, turn, place, shapes = (
            torch.from_numpy(np.asarray(content[key], np.float32).ravel()) for key in keys
        )
    except (TypeError, ValueError, OverflowError) as error:
        raise ArtifactError(f"{path}: {error}") from None
    if len(poses) == 69:  # newer files leave the root out, which Rh turns
        poses = torch.cat([poses.new_zeros(3), poses])
    if len(poses) != 72 or len(turn) != 3 or len(place) != 3 or not len(shapes):
        raise ArtifactError(
            f"{path}: wanted 72 (or 69) poses, 3 Rh, 3 Th and shapes, got {len(poses)}, "
            f"{len(turn)}, {len(place)} and {len(shapes)}"
        )
    if not (torch.cat([poses, turn, place, shapes]).abs() <= MAX_VALUE).all():
        raise ArtifactError(f"{path} holds values that are not finite or over {MAX_VALUE:g}")
    return poses.reshape(24, 3), turn, place, shapes


def _betas(shapes: Float32[Tensor, "F B"], body: Body, folder: Path) -> Float32[Tensor, " D"]:
    """The first frame's shape, in as many numbers as the body has."""
    change = float((shapes - shapes[0]).abs().max())
    if change > SAME_SHAPE:
        logger.warning("%s: shapes change by up to %.3f; the first is used", folder, change)
    count = body.shape_dirs.shape[2]
    if shapes[0, count:].any():
        raise ArtifactError(
            f"{folder}: shapes have {shapes.shape[1]} numbers, the body {count}; set the body's "
            f"shape_components to {shapes.shape[1]}"
        )
    betas = shapes.new_zeros(count)
    given = shapes[0, :count]
    betas[: len(given)] = given
    return betas


def _compare_vertices(root: Path, numbers: Sequence[int], body: Body, poses: Poses) -> None:
    for frame in (0, len(numbers) - 1):
        path = file_inside(root, f"{VERTICES}/{numbers[frame]}.npy")
        if not path.exists():
            continue
        given = load_npy(path)
        shape = tuple(body.vertices.shape)
        if isinstance(given, dict) or given.shape != shape or given.dtype.kind not in "fiu":
            found = "a dictionary" if isinstance(given, dict) else f"{list(given.shape)}"
            raise ArtifactError(
                f"{path}: wanted the body's {list(body.vertices.shape)} vertices, got {found}; the "
                "scene's body must be the SMPL file that the poses were fitted with"
            )
        ours = posed(body, poses.at([frame])).vertices[0]
        distance = (ours - torch.from_numpy(given.astype(np.float32))).norm(dim=1)
        mean_mm = 1000 * float(distance.mean())
        report = logger.warning if mean_mm > NEAR_MM else logger.info
        report("frame %d: the body is %.2f mm from %s on average", frame, mean_mm, path)
