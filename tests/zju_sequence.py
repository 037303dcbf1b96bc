"""A sequence in ZJU-MoCap's raw layout, and its body as an SMPL file: a capsule person, 9 cameras.

Lenses distort, the body has pose blend shapes and its pelvis is not at the origin. Vertices are
made as EasyMocap defines them, without the code under test: R(Rh) X(poses, shapes) + Th.
"""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from PIL import Image

from deblur_avatar.artifacts.body import SMPL_PARENTS, Body
from deblur_avatar.bodies.capsule import capsule_body
from deblur_avatar.bodies.posed_body import posed_vertices
from deblur_avatar.geometry.cameras import look_at
from deblur_avatar.rendering.mesh_rendering import cast_rays
from tests.walking_person import walking_poses

CAMERAS, SIZE = 9, 128
SHAPES = 10
DISTORTION = (-0.4, 0.1, 0.008, -0.006, 0.02)
PELVIS = (0.01, -0.24, 0.03)  # SMPL's own is 0.24 m below its origin


@dataclass(frozen=True)
class Sequence:
    """Where it lies, and the truth it was made of."""

    root: Path
    smpl_file: Path
    vertices: list[np.ndarray]  # of each frame, world
    Ks: np.ndarray  # OpenCV's pixel centres
    viewmats: np.ndarray


def smpl_like_body() -> Body:
    """The capsule body away from the origin, with pose blend shapes and ten shape numbers."""
    body, shift = capsule_body(), torch.tensor(PELVIS)
    generator = torch.Generator().manual_seed(1)
    more = torch.zeros(len(body.vertices), 3, SHAPES - body.shape_dirs.shape[2])
    return dataclasses.replace(
        body,
        vertices=body.vertices + shift,
        joints=body.joints + shift,
        shape_dirs=torch.cat([body.shape_dirs, more], dim=2),
        joint_dirs=torch.cat([body.joint_dirs, more[: len(body.joints)]], dim=2),
        pose_dirs=torch.randn(len(body.vertices), 3, 207, generator=generator) * 5e-4,
    )


def write_smpl(path: Path, body: Body) -> Path:
    """Write a body under SMPL's keys; the regressor is the smallest that gives its joints."""
    known = torch.cat([body.vertices[..., None], body.shape_dirs], -1).flatten(1).double()
    wanted = torch.cat([body.joints[..., None], body.joint_dirs], -1).flatten(1).double()
    ones = torch.ones(len(known), 1)
    regressor = torch.cat([wanted, ones[: len(wanted)]], 1) @ torch.linalg.pinv(
        torch.cat([known, ones], 1)
    )
    parents = np.array([2**32 - 1, *SMPL_PARENTS[1:]], np.uint32)
    np.savez(
        path,
        v_template=body.vertices.double(),
        shapedirs=body.shape_dirs.double(),
        posedirs=body.pose_dirs.double(),
        weights=body.lbs_weights.double(),
        J_regressor=regressor,
        kintree_table=np.stack([parents, np.arange(24, dtype=np.uint32)]),
        f=body.faces.numpy().astype(np.uint32),
    )
    return path


def write_sequence(folder: Path, frames: int) -> Sequence:
    """Film the walking capsule person; annotations, pictures, masks, parameters and vertices."""
    root, body = folder / "CoreView_9", smpl_like_body()
    poses = walking_poses(body, frames)
    rng = np.random.default_rng(0)
    Ks, viewmats = _cameras()
    vertices = []
    for name in ("new_params", "new_vertices"):
        (root / name).mkdir(parents=True)
    for frame in range(frames):
        turn = np.array([np.pi / 2, 0.0, 0.0]) + 0.1 * np.sin(0.2 * frame)  # a world with +Z up
        place = np.array([0.1 + 0.02 * frame, 0.2, 1.1])
        still = posed_vertices(
            body, poses.betas, torch.zeros(3), poses.body_pose[frame], torch.zeros(3)
        )
        vertices.append(still.double().numpy() @ cv2.Rodrigues(turn)[0].T + place)
        pose = np.concatenate([np.zeros(3), poses.body_pose[frame].numpy().ravel()])
        content = {"poses": pose[None], "Rh": turn[None], "Th": place[None]}
        np.save(root / f"new_params/{frame}.npy", {**content, "shapes": poses.betas.numpy()[None]})
        np.save(root / f"new_vertices/{frame}.npy", vertices[-1].astype(np.float32))
    names = [f"Camera_B{camera + 1}" for camera in range(CAMERAS)]
    for camera, name in enumerate(names):
        for part in ("", "mask/", "mask_cihp/"):
            (root / f"{part}{name}").mkdir(parents=True)
        background = rng.integers(60, 90, (SIZE, SIZE, 3), dtype=np.uint8)
        for frame in range(frames):
            picture, mask = _film(vertices[frame], body, Ks[camera], viewmats[camera], background)
            file = f"{name}/{frame:06d}"
            Image.fromarray(picture).save(root / f"{file}.jpg", quality=97)
            Image.fromarray(mask.astype(np.uint8)).save(root / f"mask/{file}.png")
            labels = Image.fromarray(mask.astype(np.uint8) * (1 + frame % 19), mode="P")
            labels.putpalette([255, 255, 255] + [0, 0, 0] * 19)
            labels.save(root / f"mask_cihp/{file}.png")
    cams = {
        "K": list(Ks),
        "R": [viewmat[:3, :3] for viewmat in viewmats],
        "T": [viewmat[:3, 3:] * 1000 for viewmat in viewmats],
        "D": [np.array(DISTORTION)[:, None]] * CAMERAS,
    }
    ims = [{"ims": [f"{name}/{frame:06d}.jpg" for name in names]} for frame in range(frames)]
    np.save(root / "annots.npy", {"cams": cams, "ims": ims})
    smpl_file = write_smpl(folder / "SMPL_NEUTRAL.npz", body)
    return Sequence(root, smpl_file, vertices, Ks, viewmats)


def _cameras() -> tuple[np.ndarray, np.ndarray]:
    """A ring around the person, some higher; principal points beside the middle."""
    target, up = torch.tensor([0.2, 0.2, 1.0]), torch.tensor([0.0, 0.0, 1.0])
    Ks, viewmats = [], []
    for camera in range(CAMERAS):
        angle = torch.tensor(2 * torch.pi * camera / CAMERAS)
        away = torch.stack([3.4 * angle.sin(), -3.4 * angle.cos(), 0.3 * torch.sin(3 * angle)])
        viewmats.append(look_at(target + away, target, up).double().numpy())
        focal, middle = 1.6 * SIZE, SIZE / 2 - 0.5
        Ks.append(np.array([[focal, 0, middle + 2], [0, focal, middle - 1.5], [0, 0, 1.0]]))
    return np.stack(Ks), np.stack(viewmats)


def silhouette(
    vertices: np.ndarray, faces: np.ndarray, pixels: np.ndarray, viewmat: np.ndarray
) -> np.ndarray:
    """Which triangle is seen along each ray, -1 for none; `pixels` on the plane at depth 1."""
    directions = np.concatenate([pixels, np.ones_like(pixels[:, :1])], 1) @ viewmat[:3, :3]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    centre = -viewmat[:3, :3].T @ viewmat[:3, 3]
    return cast_rays(vertices, faces, centre, directions).triangle


def _film(
    vertices: np.ndarray,
    body: Body,
    K: np.ndarray,
    viewmat: np.ndarray,
    background: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """A distorted picture and its mask: what the ray through the middle of each pixel meets."""
    x, y = np.meshgrid(np.arange(SIZE, dtype=float), np.arange(SIZE, dtype=float))
    straight = cv2.undistortPoints(
        np.stack([x, y], -1).reshape(-1, 1, 2), K, np.array(DISTORTION)
    ).reshape(-1, 2)
    triangle = silhouette(vertices, body.faces.numpy(), straight, viewmat)
    mask = (triangle >= 0).reshape(SIZE, SIZE)
    parts = body.lbs_weights.argmax(1)[body.faces[:, 0]].numpy()  # a colour for each part
    colours = 55 + 200 * (0.5 + 0.5 * np.sin(parts[:, None] * np.array([1.0, 2.3, 4.1])))
    picture = background.copy()
    picture[mask] = colours[triangle[mask.ravel()]].astype(np.uint8)
    return picture, mask
