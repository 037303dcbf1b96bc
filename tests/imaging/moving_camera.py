"""Frames of a camera that moves over a painted wall, past a person who walks faster."""

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

SIZE = (160, 120)  # width, height
FENCE = 40  # pixels


def wall(seed: int = 0) -> UInt8[np.ndarray, "H W 3"]:
    """A wall full of corners."""
    drawn = np.random.default_rng(seed)
    picture = np.full((400, 500, 3), 120, np.uint8)
    for _ in range(700):
        corner = drawn.integers(0, (480, 380))
        end = corner + drawn.integers(4, 24, 2)
        color = drawn.integers(0, 255, 3).tolist()
        cv2.rectangle(picture, corner.tolist(), end.tolist(), color, -1)
    return cv2.GaussianBlur(picture, (3, 3), 0)


def wall_from_frame(index: int) -> Float[np.ndarray, "3 3"]:
    """A pan with a drift, a roll and a zoom."""
    angle, zoom = 0.004 * index, 1 + 0.004 * index
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) / zoom
    shift = np.array([120 + 4.0 * index, 130 + 8 * np.sin(index / 3)])
    return np.vstack([np.c_[turn, shift], [0, 0, 1]])


def turned(frames: int, degrees: float = 0.0, zoom: float = 1.0) -> list[Float[np.ndarray, "3 3"]]:
    """A roll and a zoom about the picture's middle: where each frame lies on the wall."""
    middle = SIZE[0] / 2, SIZE[1] / 2
    start = np.array([[1, 0, 150], [0, 1, 130], [0, 0, 1]])
    steps = np.linspace(0, 1, frames)
    rolls = [cv2.getRotationMatrix2D(middle, degrees * s, 1 + (zoom - 1) * s) for s in steps]
    return [start @ np.vstack([roll, [0, 0, 1]]) for roll in rolls]


def filmed(
    frames: int = 16,
    parallax: float = 0.0,
    camera: list[Float[np.ndarray, "3 3"]] | None = None,
) -> tuple[UInt8[Tensor, "F H W 3"], UInt8[Tensor, "F H W"], UInt8[Tensor, "F H W 3"]]:
    """Frames, mattes, and the true background of each frame.

    Args:
        frames: how many.
        parallax: how far a fence on the left, nearer than the wall, moves, pixels a frame.
        camera: where each frame lies on the wall, `wall_from_frame` unless told, with a person who
            then walks to and fro.
    """
    painted = wall()
    pictures, mattes, behind = [], [], []
    for index in range(frames):
        placed = wall_from_frame(index) if camera is None else camera[index]
        bare = cv2.warpPerspective(
            painted, placed, SIZE, flags=cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR
        )
        if parallax:
            start = round(parallax * index)
            bare[:, :FENCE] = wall(1)[100:220, start : start + FENCE]
        alpha = np.zeros((SIZE[1], SIZE[0]), np.float32)
        place = (40 + 5 * index if camera is None else 80 + round(30 * np.sin(index / 4)), 60)
        cv2.ellipse(alpha, place, (10, 28), 0, 0, 360, 1.0, -1)
        alpha = cv2.blur(alpha, (7, 3))  # moves while the shutter is open
        person = np.array([30.0, 200.0, 60.0])
        blended = bare * (1 - alpha[..., None]) + person * alpha[..., None]
        pictures.append(blended.round().astype(np.uint8))
        mattes.append((alpha * 255).round().astype(np.uint8))
        behind.append(bare)
    stacks = [torch.from_numpy(np.stack(stack)) for stack in (pictures, mattes, behind)]
    return stacks[0], stacks[1], stacks[2]
