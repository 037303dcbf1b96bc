"""Pictures of the check: mask, body and skeleton over sample frames, and the scene from above.

Outlines: yellow the mask, blue the body; bones are white on the middle, red on the left and green
on the right. From above, the camera looks along its cone at the path of the pelvis; strokes show
which way the body faced.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8

from deblur_avatar.animation.stage import stage_of_clip
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.evaluation.body_silhouette import INSIDE
from deblur_avatar.evaluation.scene_measures import silhouette, spaced_frames
from deblur_avatar.geometry.cameras import camera_centres, project
from deblur_avatar.geometry.rotations import axis_angle_to_matrix
from deblur_avatar.imaging.contact_sheets import contact_sheet
from deblur_avatar.reporting.findings_table import findings_table
from deblur_avatar.reporting.page import picture_uri, render_page

Picture = UInt8[np.ndarray, "_ _ 3"]

TEMPLATE = Path(__file__).parent / "check.html.jinja"
FRAMES, COLUMNS, HEIGHT = 7, 4, 380  # pictures; pictures a row; pixels
MASK, BODY, MIDDLE, LEFT, RIGHT = (
    (255, 210, 40), (70, 150, 255), (255, 255, 255), (255, 90, 80), (90, 220, 110),
)  # fmt: skip
PATH, PAPER, INK = (30, 90, 200), (245, 245, 245), (40, 40, 40)


def draw_check(observations: Observations) -> Picture:
    """Draw the sheet of overlays, the view from above last."""
    chosen = spaced_frames(observations, FRAMES)
    pictures = [_overlay(observations, position) for position in chosen]
    labels = [
        f"frame {observations.frame_indices[p]}, trust {float(observations.weights[p]):.2f}"
        for p in chosen
    ]
    pictures.append(_from_above(observations))
    return contact_sheet(pictures, COLUMNS, [*labels, "from above, 1 m grid"])


def check_page(scene: str, content: Mapping[str, Any], sheet: Picture) -> str:
    """The findings and the sheet on one page that loads nothing."""
    findings = findings_table(content["findings"])
    sheet_uri = picture_uri(sheet)
    return render_page(TEMPLATE, scene=scene, check=content, findings=findings, sheet=sheet_uri)


def _overlay(observations: Observations, position: int) -> Picture:
    frame = observations.frames[position].numpy()
    scale = HEIGHT / frame.shape[0]
    size = (max(1, round(frame.shape[1] * scale)), HEIGHT)
    canvas = np.array(cv2.resize(frame, size, interpolation=cv2.INTER_LINEAR))
    _outline(canvas, observations.mattes[position].numpy() > INSIDE, MASK)
    _outline(canvas, silhouette(observations, position), BODY)
    _skeleton(canvas, observations, position, scale)
    return canvas


def _outline(canvas: Picture, inside: Bool[np.ndarray, "H W"], color: tuple[int, ...]) -> None:
    size = canvas.shape[1], canvas.shape[0]
    large = cv2.resize(inside.astype(np.uint8) * 255, size, interpolation=cv2.INTER_LINEAR)
    pieces, _ = cv2.findContours(
        (large > INSIDE).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(canvas, pieces, -1, color, 1, cv2.LINE_AA)


def _skeleton(canvas: Picture, observations: Observations, position: int, scale: float) -> None:
    body = observations.body
    joints = posed(body, observations.poses.at([position])).joints[0]
    camera = observations.camera
    pixels = (project(joints, camera.K, camera.viewmat)[0] * scale).round().long().tolist()
    for joint, parent in enumerate(body.parents):
        if parent >= 0:
            name = body.joint_names[joint]
            color = (
                LEFT if name.startswith("left") else RIGHT if name.startswith("right") else MIDDLE
            )
            cv2.line(canvas, pixels[parent], pixels[joint], color, 1, cv2.LINE_AA)


def _from_above(observations: Observations) -> Picture:
    """Cameras, the way of the pelvis, and which way the body faced."""
    poses, cameras = observations.poses, observations.cameras
    joints = posed(observations.body, poses).joints
    try:
        stage = stage_of_clip(observations, poses.betas).world_from_stage
    except ValueError:  # seen from straight above: any direction is as good
        stage = torch.eye(3)
    way = (joints[:, 0] @ stage)[:, [0, 2]].numpy()
    eyes = (camera_centres(cameras.viewmats) @ stage)[:, [0, 2]].numpy()
    ahead = (cameras.viewmats[:, 2, :3] @ stage)[:, [0, 2]].numpy()
    facing = (axis_angle_to_matrix(poses.global_orient)[..., 2] @ stage)[:, [0, 2]].numpy()
    points = np.concatenate([way, eyes])
    middle, half = (
        (points.min(0) + points.max(0)) / 2,
        float(np.ptp(points, axis=0).max()) / 2 + 0.6,
    )
    canvas = np.full((HEIGHT, HEIGHT, 3), PAPER, np.uint8)

    def place(point: np.ndarray) -> tuple[int, int]:
        x, y = (point - middle + half) / (2 * half) * HEIGHT
        return round(float(x)), round(float(y))

    for line in range(int(np.floor(-half)), int(np.ceil(half)) + 1):
        for ends in ([[line, -half], [line, half]], [[-half, line], [half, line]]):
            a, b = (place(np.array(end) + np.round(middle)) for end in ends)
            cv2.line(canvas, a, b, (225, 225, 225), 1)
    for index, (eye, direction) in enumerate(zip(eyes, ahead, strict=True)):
        color = PATH if index == observations.train_camera else (150, 150, 150)
        width = float(cameras.sizes[index, 0]) / 2 / float(cameras.Ks[index, 0, 0])
        direction = direction / max(float(np.linalg.norm(direction)), 1e-6)
        beside = np.array([-direction[1], direction[0]])
        for side in (-1, 1):
            cv2.line(canvas, place(eye), place(eye + 0.8 * (direction + side * width * beside)),
                     color, 1, cv2.LINE_AA)  # fmt: skip
        cv2.circle(canvas, place(eye), 4, color, -1, cv2.LINE_AA)
    trail = np.array([place(point) for point in way], np.int32)
    cv2.polylines(canvas, [trail], False, INK, 1, cv2.LINE_AA)
    for index in range(0, len(way), max(1, len(way) // 24)):
        cv2.line(canvas, place(way[index]), place(way[index] + 0.3 * facing[index]), LEFT, 1,
                 cv2.LINE_AA)  # fmt: skip
    return canvas
