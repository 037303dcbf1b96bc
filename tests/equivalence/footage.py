"""Footage of the small cases: every file that a source reads, of capsule persons, in seconds.

    python -m tests.equivalence.footage --out experiments/cases/data/footage

What is written: a ZJU-MoCap sequence with its body as an SMPL file (`tests/zju_sequence.py`), one
camera's video with masks, keypoints and poses beside it, a dance as an AMASS file, and weights of
a deblurring network that nobody has trained. The two
other sources need nothing (`studio`) or real videos (`multiview`: what the root pipeline reads).
"""

import argparse
import json
import math
import shutil
from pathlib import Path

import cv2
import numpy as np
import torch
from PIL import Image

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.bodies.posed_body import posed_joints, posed_vertices
from deblur_avatar.bodies.triangle_joints import triangle_joints
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from deblur_avatar.imaging.dstnet import Dstnet, DstnetParams
from deblur_avatar.imaging.dstnet_weights import DstnetWeights
from tests.sources.small_videos import write_video
from tests.walking_person import walking_poses
from tests.zju_sequence import silhouette, smpl_like_body, write_sequence

FRAMES = 14
WIDTH, HEIGHT = 96, 128
FOCAL, DISTANCE = 180.0, 3.4  # pixels, metres
COCO = (0, 1, 2, 4, 5, 16, 17, 18, 19, 20, 21, 1, 2, 4, 5, 7, 8)  # a joint for each of its 17
DANCE_FPS = 60.0


def write_footage(folder: Path) -> None:
    """Write everything anew."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    write_sequence(folder, FRAMES)
    _write_video(folder / "video")
    _write_dance(folder / "dance.npz")
    _write_network(folder / "dstnet")


def _write_video(folder: Path) -> None:
    """The capsule person before a camera at the origin, and all that a user can bring along."""
    body = smpl_like_body()
    poses = _before_camera(walking_poses(body, FRAMES))
    motion = poses.betas, poses.global_orient, poses.body_pose, poses.transl
    parts = triangle_joints(body).numpy()  # a colour for each
    colours = 55 + 200 * (0.5 + 0.5 * np.sin(parts[:, None] * np.array([1.0, 2.3, 4.1])))
    plate = np.random.default_rng(0).integers(60, 90, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float) + 0.5
    rays = np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL], -1).reshape(-1, 2)
    (folder / "masks").mkdir(parents=True)
    pictures = []
    for frame, vertices in enumerate(posed_vertices(body, *motion).double().numpy()):
        triangle = silhouette(vertices, body.faces.numpy(), rays, np.eye(4))
        mask = (triangle >= 0).reshape(HEIGHT, WIDTH)
        picture = plate.copy()
        picture[mask] = colours[triangle[mask.ravel()]].astype(np.uint8)
        pictures.append(cv2.blur(picture, (3, 1)))
        Image.fromarray(mask.astype(np.uint8) * 255).save(folder / "masks" / f"{frame:03d}.png")
    write_video(folder / "person.mp4", pictures)
    joints = posed_joints(body, *motion)[:, list(COCO)].numpy()
    pixels = joints[..., :2] / joints[..., 2:] * FOCAL + np.array([WIDTH / 2, HEIGHT / 2])
    marks = np.concatenate([pixels, np.full_like(pixels[..., :1], 2.0)], -1)
    people = [
        {"image_id": frame, "keypoints": person.ravel().tolist()}
        for frame, person in enumerate(marks)
    ]
    (folder / "keypoints.json").write_text(json.dumps(people))
    np.savez(
        folder / "poses.npz",
        betas=poses.betas.numpy(),
        global_orient=poses.global_orient.numpy(),
        body_pose=poses.body_pose.numpy(),
        transl=poses.transl.numpy(),
    )


def _before_camera(poses: Poses) -> Poses:
    """The same steps in OpenCV's axes, whose Y points down, in front of the camera."""
    turn = axis_angle_to_matrix(torch.tensor([math.pi, 0.0, 0.0]))
    return Poses(
        betas=poses.betas,
        global_orient=matrix_to_axis_angle(turn @ axis_angle_to_matrix(poses.global_orient)),
        body_pose=poses.body_pose,
        transl=poses.transl @ turn.T + torch.tensor([0.0, 0.0, DISTANCE]),
    )


def _write_dance(path: Path) -> None:
    """Steps in AMASS's form: 52 joints, Z up."""
    poses = walking_poses(smpl_like_body(), FRAMES)
    turns = np.zeros((FRAMES, 156))
    turns[:, 0] = math.pi / 2
    turns[:, 3:66] = poses.body_pose[:, :21].flatten(1).numpy()
    np.savez(
        path,
        poses=turns,
        trans=poses.transl.numpy()[:, [0, 2, 1]],
        betas=np.zeros(16),
        mocap_framerate=np.array(DANCE_FPS),
        gender=np.array("female"),
    )


def _write_network(folder: Path) -> None:
    """A tiny network that does something: shipped weights may change, and small cases must not."""
    sizes = DstnetParams(features=2, blocks=1, refinements=1)
    network = Dstnet(sizes)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(0.2 * torch.randn(parameter.shape, generator=generator))
    weights = DstnetWeights(
        recipe="{}", clips="", tensors=network.state_dict(), **sizes.model_dump()
    )
    weights.save(folder)


def main() -> int:
    """Write the files of all cases."""
    parser = argparse.ArgumentParser(description=write_footage.__doc__)
    parser.add_argument("--out", type=Path, required=True)
    write_footage(parser.parse_args().out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
