"""Street behind a person: textured planes at several depths, seen through homographies.

Conventions. The studio's world: +Y up, the floor at y = 0, the person about the origin, cameras on
+Z, metres. A plane's texture is linear light and coverage; pixel (x, y) of it lies at
`world_from_texture` (x, y, 1). Planes are drawn from the farthest to the nearest.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, Float32

from deblur_avatar.imaging.color import srgb_to_linear

TEXEL = 0.014  # metres: about a pixel of a picture 540 high at the facade's distance
OCTAVES = 6  # of the noise that surfaces are made of
FACADE, FACADE_WIDTH, FACADE_HEIGHT = -6.0, 34.0, 12.0  # metres: its z, its size
GROUND_NEAR, GROUND_WIDTH = 2.4, 30.0  # metres
SKY, SKY_SIZE = -60.0, 160.0  # metres: its z, its size
# Thin things that stand about: x, z, width, height in metres, and what they are.
STANDING = (
    (-3.6, -4.6, 2.6, 4.8, "tree"), (3.9, -4.0, 2.4, 4.4, "tree"), (-1.7, -3.0, 0.12, 3.4, "post"),
    (2.3, -2.6, 1.3, 1.0, "box"), (-2.9, -1.6, 0.7, 0.9, "box"), (1.5, -4.9, 0.9, 1.9, "box"),
)  # fmt: skip


@dataclass(frozen=True)
class Plane:
    """One textured plane."""

    texture: Float32[np.ndarray, "h w 4"]  # light times coverage, and coverage
    world_from_texture: Float[np.ndarray, "3 3"]  # columns: a step in x, one in y, the corner


def street(random: np.random.Generator) -> list[Plane]:
    """A facade, a pavement, trees, a post and boxes, the farthest first."""
    planes = [_sky(), _facade(random), _ground(random)]
    for x, z, width, height, kind in sorted(STANDING, key=lambda entry: entry[1]):
        planes.append(_standing(random, (x, z), (width, height), kind))
    return planes


def draw_backdrop(
    planes: Sequence[Plane],
    K: Float[np.ndarray, "3 3"],
    viewmat: Float[np.ndarray, "4 4"],
    size: tuple[int, int],
) -> Float32[np.ndarray, "H W 3"]:
    """What a camera sees of them, linear light over nothing.

    Args:
        planes: the farthest first, all of each in front of the camera.
        K: pixels, the centre of the top left one at (0.5, 0.5).
        viewmat: world to camera.
        size: width and height, pixels.
    """
    picture = np.zeros((size[1], size[0], 3), np.float32)
    corner = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV's pixels begin at (0, 0)
    for plane in planes:
        in_camera = viewmat[:3, :3] @ plane.world_from_texture
        in_camera[:, 2] += viewmat[:3, 3]
        homography = np.linalg.inv(corner) @ K @ in_camera @ corner
        left, top, right, bottom = _box_of(plane, homography, size)
        if right <= left or bottom <= top:
            continue
        shift = np.array([[1, 0, -left], [0, 1, -top], [0, 0, 1]])
        seen = cv2.warpPerspective(
            plane.texture, shift @ homography, (right - left, bottom - top), flags=cv2.INTER_LINEAR
        )
        part = picture[top:bottom, left:right]
        part *= 1 - seen[..., 3:]
        part += seen[..., :3]
    return picture


def _box_of(
    plane: Plane, homography: Float[np.ndarray, "3 3"], size: tuple[int, int]
) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of the pixels that a plane reaches."""
    rows, columns = plane.texture.shape[:2]
    corners = np.array([[[-1, -1], [columns, -1], [columns, rows], [-1, rows]]], np.float64)
    pixels = cv2.perspectiveTransform(corners, homography)[0]
    low = np.clip(np.floor(pixels.min(0)), 0, size).astype(int)
    high = np.clip(np.ceil(pixels.max(0)) + 1, 0, size).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _sky() -> Plane:
    rows = np.linspace(1, 0, 64, dtype=np.float32)[:, None, None]
    light = np.array([0.42, 0.55, 0.8], np.float32) * rows + (1 - rows) * 0.75
    light = np.broadcast_to(light, (64, 64, 3)).astype(np.float32)
    return _upright(light, np.ones((64, 64), np.float32), (0.0, SKY), (SKY_SIZE, SKY_SIZE / 2))


def _facade(random: np.random.Generator) -> Plane:
    """Bricks, and rows of windows each of another brightness."""
    rows, columns = round(FACADE_HEIGHT / TEXEL), round(FACADE_WIDTH / TEXEL)
    y, x = np.mgrid[:rows, :columns].astype(np.float32) * TEXEL
    row = np.floor(y / 0.09)
    joint = ((y / 0.09) % 1 < 0.12) | (((x + 0.11 * (row % 2)) / 0.22) % 1 < 0.06)
    srgb = np.array([0.55, 0.36, 0.29]) * (1 + 0.5 * _fractal(random, (rows, columns)))[..., None]
    srgb[joint] = 0.62
    for low in np.arange(0.8, FACADE_HEIGHT - 2, 2.9):
        for left in np.arange(0.7, FACADE_WIDTH - 1.5, 2.3):
            inside = _box(x, y, (left, low, left + 1.2, low + 1.7))
            glass = _box(x, y, (left + 0.08, low + 0.08, left + 1.12, low + 1.62))
            srgb[inside] = 0.85
            srgb[glass] = random.uniform(0.08, 0.5) * np.array([0.8, 0.95, 1.1])
            srgb[glass & (np.abs(x - left - 0.6) < 0.03)] = 0.85
    light = _linear(srgb)
    size = (FACADE_WIDTH, FACADE_HEIGHT)
    return _upright(light, np.ones(light.shape[:2], np.float32), (0.0, FACADE), size)


def _ground(random: np.random.Generator) -> Plane:
    """Paving stones of slightly different greys."""
    texel = 1.5 * TEXEL
    rows, columns = round((GROUND_NEAR - FACADE) / texel), round(GROUND_WIDTH / texel)
    y, x = np.mgrid[:rows, :columns].astype(np.float32) * texel
    stone = random.uniform(-0.07, 0.07, (64, 128))
    shade = 0.5 + stone[(y / 0.4).astype(int) % 64, (x / 0.6).astype(int) % 128]
    shade = shade + 0.25 * _fractal(random, (rows, columns))
    shade[((y / 0.4) % 1 < 0.06) | ((x / 0.6) % 1 < 0.04)] = 0.3
    light = _linear(shade[..., None] * np.array([1.0, 0.97, 0.92]))
    place = np.array([[texel, 0, -GROUND_WIDTH / 2], [0, 0, 0], [0, texel, FACADE]])
    return Plane(_layer(light, np.ones(light.shape[:2], np.float32)), place)


def _standing(
    random: np.random.Generator, place: tuple[float, float], size: tuple[float, float], kind: str
) -> Plane:
    rows, columns = round(size[1] / TEXEL), max(4, round(size[0] / TEXEL))
    y, x = np.mgrid[:rows, :columns].astype(np.float32) * TEXEL
    noise = _fractal(random, (rows, columns))
    coverage = np.ones((rows, columns), np.float32)
    if kind == "tree":
        crown = 1 - np.hypot((x / size[0] - 0.5) / 0.5, (y / size[1] - 0.32) / 0.32)
        trunk = np.abs(x / size[0] - 0.5) < 0.035
        leaves = crown + 0.9 * noise > 0.05
        coverage = (leaves | (trunk & (y > 0.3 * size[1]))).astype(np.float32)
        srgb = np.where(leaves[..., None], [0.24, 0.38, 0.16], [0.32, 0.25, 0.19])
        srgb = srgb * (1 + 0.9 * noise[..., None])
    elif kind == "post":
        srgb = np.full((rows, columns, 3), 0.35) * (0.6 + 0.8 * (x / size[0])[..., None])
    else:
        srgb = random.uniform(0.15, 0.7, 3) * (1 + 0.3 * noise[..., None])
        srgb[_box(x, y, (0.1 * size[0], 0.2 * size[1], 0.9 * size[0], 0.45 * size[1]))] = 0.8
    return _upright(_linear(srgb), cv2.GaussianBlur(coverage, (0, 0), 0.7), place, size)


def _upright(
    light: Float32[np.ndarray, "h w 3"],
    coverage: Float32[np.ndarray, "h w"],
    place: tuple[float, float],
    size: tuple[float, float],
) -> Plane:
    """A plane that faces +Z and stands on the floor, its middle at x, at depth z."""
    rows, columns = coverage.shape
    (x, z), (width, height) = place, size
    corner = [x - width / 2, height, z]
    step_x, step_y = [width / columns, 0, 0], [0, -height / rows, 0]
    return Plane(_layer(light, coverage), np.array([step_x, step_y, corner]).T)


def _layer(
    light: Float32[np.ndarray, "h w 3"], coverage: Float32[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w 4"]:
    return np.dstack([light * coverage[..., None], coverage]).astype(np.float32)


def _fractal(random: np.random.Generator, shape: tuple[int, int]) -> Float32[np.ndarray, "h w"]:
    """Noise of several sizes, each half as strong as the next larger one; about -0.5 to 0.5."""
    total = np.zeros(shape, np.float32)
    for octave in range(OCTAVES):
        coarse = (max(2, shape[0] >> (OCTAVES - octave)), max(2, shape[1] >> (OCTAVES - octave)))
        grid = random.uniform(-0.5, 0.5, coarse).astype(np.float32)
        total += cv2.resize(grid, shape[::-1], interpolation=cv2.INTER_CUBIC) / 2**octave
    return total / 2


def _box(
    x: Float32[np.ndarray, "h w"],
    y: Float32[np.ndarray, "h w"],
    corners: tuple[float, float, float, float],
) -> np.ndarray:
    left, top, right, bottom = corners
    return (x > left) & (x < right) & (y > top) & (y < bottom)


def _linear(srgb: Float[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    linear = srgb_to_linear(torch.from_numpy(np.clip(srgb, 0, 1)))
    return np.asarray(linear.numpy(), np.float32)
