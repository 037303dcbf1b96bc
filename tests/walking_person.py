"""A capsule person who walks and waves, as a perfect detector sees her in several cameras."""

import math

import numpy as np
import torch

from deblur_avatar.artifacts.body import SMPL_JOINT_NAMES, Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import (
    joint_transforms,
    posed_vertices,
    shaped_joints,
)
from deblur_avatar.body_estimation.body_landmarks import landmark_map
from deblur_avatar.body_estimation.landmarks import COUNT, Landmarks
from deblur_avatar.body_estimation.part_fit import GROUPS, HAND_ROWS, PART_MAP
from deblur_avatar.body_estimation.part_landmarks import HAND_COUNT, PartLandmarks
from deblur_avatar.geometry.cameras import look_at, project
from deblur_avatar.rendering.mesh_rendering import View, cast_rays

FPS = 60.0
SIZE = (96, 128)  # width and height of the pictures
EYES = ((0.0, 0.3, 3.5), (3.0, 0.2, 1.5), (-3.0, 0.4, 1.5), (0.4, 0.2, -3.5))


def walking_poses(body: Body, frames: int) -> Poses:
    """Turns, steps, bends her knees and waves; shape numbers are not zero."""
    time = torch.arange(frames) / FPS
    pose = torch.zeros(frames, len(body.parents) - 1, 3)

    def bend(joint: str, axis: int, degrees: torch.Tensor) -> None:
        pose[:, SMPL_JOINT_NAMES.index(joint) - 1, axis] = torch.deg2rad(degrees)

    swing = torch.sin(2 * math.pi * 1.5 * time)
    bend("left_shoulder", 2, -60 + 25 * swing)
    bend("right_shoulder", 2, 50 + 20 * swing)
    bend("left_elbow", 1, -50 + 20 * swing)
    bend("left_hip", 0, -30 * swing - 20)
    bend("left_knee", 0, 40 + 20 * swing)
    bend("spine2", 1, 10 * swing)
    turn = torch.stack([0 * time, 0.4 + 1.5 * time, 0 * time], dim=-1)
    place = torch.stack([0.8 * time, 0.02 * swing, 0.1 + 0 * time], dim=-1)
    betas = torch.zeros(body.shape_dirs.shape[2])
    betas[:2] = torch.tensor([0.6, -0.5])
    return Poses(betas=betas, global_orient=turn, body_pose=pose, transl=place)


def ring_of_cameras(count: int = 4) -> Cameras:
    up, width, height = torch.tensor([0.0, 1.0, 0.0]), *SIZE
    K = torch.tensor([[1.5 * width, 0, width / 2], [0, 1.5 * width, height / 2], [0, 0, 1]])
    return Cameras(
        Ks=K.repeat(count, 1, 1),
        viewmats=torch.stack(
            [look_at(torch.tensor(eye), torch.zeros(3), up) for eye in EYES[:count]]
        ),
        distortion=torch.zeros(count, 5),
        sizes=torch.tensor([SIZE] * count),
        names=tuple(f"cam{index}" for index in range(count)),
    )


def detect_perfectly(body: Body, poses: Poses, cameras: Cameras, camera: int) -> Landmarks:
    """Landmarks where the body has them, in space too; mattes as its mesh fills them."""
    motion = poses.betas, poses.global_orient, poses.body_pose, poses.transl
    marks = landmark_map()
    joints = shaped_joints(body, poses.betas)
    positions = marks.positions(joint_transforms(body, *motion), joints, marks.offsets)
    lens = cameras.Ks[camera], cameras.viewmats[camera]
    frames = len(poses.transl)
    points, visibility = torch.zeros(frames, COUNT, 2), torch.zeros(frames, COUNT)
    points[:, list(marks.rows)] = project(positions, *lens)[0]
    visibility[:, list(marks.rows)] = 1.0
    world = torch.zeros(frames, COUNT, 3)
    in_camera = positions @ cameras.viewmats[camera][:3, :3].T
    hips = [marks.rows.index(mark) for mark in (23, 24)]
    world[:, list(marks.rows)] = in_camera - in_camera[:, hips].mean(1, keepdim=True)
    view, faces = View.of(cameras, camera, samples_per_axis=1), body.faces.numpy()
    rays = view.directions.reshape(-1, 3)
    mattes = [
        (cast_rays(vertices, faces, view.centre, rays).triangle >= 0).reshape(SIZE[::-1])
        for vertices in posed_vertices(body, *motion).numpy()
    ]
    return Landmarks(
        found=torch.ones(frames, dtype=torch.bool),
        points=points,
        visibility=visibility,
        mattes=torch.from_numpy(np.stack(mattes).astype(np.uint8) * 255),
        world=world,
    )


def parts_perfectly(body: Body, poses: Poses, cameras: Cameras, camera: int) -> PartLandmarks:
    """Hands and face where the body has them; those landmarks that a fit does not use are zero."""
    motion = poses.betas, poses.global_orient, poses.body_pose, poses.transl
    joints = shaped_joints(body, poses.betas)
    places = PART_MAP.positions(joint_transforms(body, *motion), joints, PART_MAP.offsets)
    pixels, _ = project(places, cameras.Ks[camera], cameras.viewmats[camera])
    away = (places - torch.linalg.inv(cameras.viewmats[camera])[:3, 3]).norm(dim=-1)
    for rows in GROUPS:
        away[:, rows] *= cameras.Ks[camera][0, 0] / away[:, rows].mean(1, keepdim=True)
    seen = torch.cat([pixels, away[..., None]], dim=-1)
    frames = len(poses.transl)
    hands = torch.zeros(frames, 2, HAND_COUNT, 3)
    for side in (0, 1):
        hands[:, side, list(HAND_ROWS)] = seen[:, GROUPS[side]]
    return PartLandmarks(
        hands=hands,
        left=torch.tensor([0.98, 0.02]).repeat(frames, 1),
        hand_found=torch.ones(frames, 2, dtype=torch.bool),
        face=seen[:, GROUPS[2]],
        face_found=torch.ones(frames, dtype=torch.bool),
        sizes=torch.full((frames,), 80.0),
    )
