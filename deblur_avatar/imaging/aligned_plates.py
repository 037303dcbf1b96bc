"""Background plates of a moving camera: frames aligned by homographies on what is not the person.

A camera that drifts, turns or zooms sees its background through one homography a frame. Frames are
matched with keyframes, warped into one mosaic, and the mosaic's median is warped back: a plate for
each frame, in that frame's light. Where the plate does not agree with the frame next to the person
(parallax, a crowd, a reflection) it is not known there, and nothing is taken for background.

Conventions. `mosaic_from_frame` [F, 3, 3] maps pixels (x, y, 1) of a frame to the mosaic's.
"""

from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from deblur_avatar.geometry.spacing import evenly_spaced
from deblur_avatar.imaging.background_features import (
    FEWEST,
    Features,
    FrameFeatures,
    matched_scale,
    matches,
)
from deblur_avatar.imaging.camera_motion import background_mask
from deblur_avatar.imaging.matting import BARE, ENOUGH, Plate, in_parts
from deblur_avatar.imaging.plate_light import even_plates
from deblur_avatar.run import in_threads

RANSAC_PIXELS = 2.0  # from a homography, still an inlier
KEY_INLIERS = 0.4  # share of a keyframe's inliers below which the frame before becomes a keyframe
MAX_MOSAIC = 6.0  # area of the mosaic, in frames; beyond, a homography has run away
MOSAIC_FRAMES = 48  # that its median is taken of
AGREEMENT = 10.0  # codes of 255 that plate and frame may differ by, on average around a pixel
AROUND = 0.03  # of the picture's height: radius of "around"


class Alignment(NamedTuple):
    """Where each frame lies in the mosaic."""

    mosaic_from_frame: Float[np.ndarray, "F 3 3"]
    size: tuple[int, int]  # of the mosaic, width and height, pixels


def aligned_plates(
    frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"], features: FrameFeatures
) -> tuple[list[Plate], Float[Tensor, "F 3"] | None] | None:
    """The background behind the person in each frame of a moving camera.

    Args:
        frames: of one camera.
        mattes: of the person.
        features: of these frames.

    Returns:
        One plate a frame, each known only where it agrees with the frame around, and the stops of
        its light where that changes; None if the frames cannot be aligned.
    """
    alignment = align_frames(features, mattes)
    if alignment is None:
        return None

    def warped_back(frames: UInt8[Tensor, "F H W 3"]) -> list[Plate]:
        mosaic, (height, width) = _mosaic(frames, mattes, alignment), mattes.shape[1:]
        return in_threads(
            lambda placed: _warped_back(mosaic, placed, (height, width)),
            alignment.mosaic_from_frame,
        )

    even = even_plates(frames, mattes, warped_back)
    plates = even.plates
    for part in in_parts(len(plates)):  # in place: all of them are as large as the clip
        lit = in_threads(even.lit, range(len(plates))[part])
        plates[part] = in_threads(believed, frames[part], mattes[part], lit)
    return plates, even.stops


def align_frames(features: FrameFeatures, mattes: UInt8[Tensor, "F H W"]) -> Alignment | None:
    """Homographies of all frames into one mosaic; None if one cannot be found.

    Each frame is matched with the last keyframe; where too little of that is left in sight, the
    frame before becomes the next keyframe.
    """
    height, width = mattes.shape[1:]
    scale, found = matched_scale(height, width), features.beside(mattes)
    placed: list[np.ndarray] = [np.eye(3)]
    key, most = 0, 0
    for index in range(1, len(found)):
        step = _homography(found[key], found[index])
        if index - 1 > key and (step is None or step[1] < KEY_INLIERS * most):
            key, most = index - 1, 0
            step = _homography(found[key], found[index])
        if step is None:
            return None
        most = max(most, step[1])
        placed.append(placed[key] @ step[0])
    shrink = np.diag([scale, scale, 1.0])
    return _in_one_mosaic(np.stack([np.linalg.inv(shrink) @ h @ shrink for h in placed]),
                          (width, height))  # fmt: skip


def _homography(key: Features, other: Features) -> tuple[np.ndarray, int] | None:
    """`key_from_other` and its inliers; None without enough of them."""
    pair = matches(key, other)
    if pair is None:
        return None
    cv2.setRNGSeed(0)  # RANSAC draws
    step, inliers = cv2.findHomography(*pair, cv2.RANSAC, RANSAC_PIXELS)
    if step is None or inliers.sum() < FEWEST:
        return None
    return step, int(inliers.sum())


def _in_one_mosaic(placed: np.ndarray, size: tuple[int, int]) -> Alignment | None:
    """Shift the mosaic so that it begins at its corner; None if it would be far too large."""
    width, height = size
    corners = np.array([[[0, 0], [width, 0], [width, height], [0, height]]], np.float64)
    if not np.isfinite(placed).all():
        return None
    there = np.concatenate([cv2.perspectiveTransform(corners, h)[0] for h in placed])
    low, high = np.floor(there.min(0)), np.ceil(there.max(0))
    wide, tall = (high - low).astype(int).tolist()
    if wide * tall > MAX_MOSAIC * width * height:
        return None
    shift = np.array([[1, 0, -low[0]], [0, 1, -low[1]], [0, 0, 1]])
    return Alignment(shift @ placed, (wide, tall))


def _mosaic(
    frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"], alignment: Alignment
) -> Plate:
    """The (lower) median of the aligned frames that are bare of the person."""
    chosen = evenly_spaced(range(len(frames)), MOSAIC_FRAMES)
    wide, tall = alignment.size
    values = np.full((len(chosen), tall, wide, 3), 255, np.uint8)
    count = np.zeros((tall, wide), np.int32)
    for row, index in enumerate(chosen):
        homography = alignment.mosaic_from_frame[index]
        bare = background_mask(mattes[index]).numpy().astype(np.uint8)
        seen = cv2.warpPerspective(bare, homography, (wide, tall), flags=cv2.INTER_NEAREST) > 0
        picture = cv2.warpPerspective(frames[index].numpy(), homography, (wide, tall))
        values[row][seen] = picture[seen]
        count += seen
    values.sort(axis=0)  # what is not bare lies behind all others
    middle = np.maximum((count - 1) // 2, 0)
    picture = np.take_along_axis(values, middle[None, :, :, None].repeat(3, 3), 0)[0]
    known = count >= ENOUGH
    picture[~known] = 0
    return Plate(torch.from_numpy(picture), torch.from_numpy(known))


def _warped_back(mosaic: Plate, placed: np.ndarray, shape: tuple[int, int]) -> Plate:
    size, flags = (shape[1], shape[0]), cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR
    picture = cv2.warpPerspective(
        mosaic.picture.numpy(), placed, size, flags=flags | cv2.INTER_LINEAR
    )
    known = mosaic.known.numpy().astype(np.uint8) * 255
    known = cv2.warpPerspective(known, placed, size, flags=flags | cv2.INTER_LINEAR) == 255
    return Plate(torch.from_numpy(picture), torch.from_numpy(known))


def believed(frame: UInt8[Tensor, "H W 3"], matte: UInt8[Tensor, "H W"], plate: Plate) -> Plate:
    """The plate, known only where the bare pixels around look like it."""
    radius = max(1, round(AROUND * matte.shape[0]))
    window = (2 * radius + 1, 2 * radius + 1)
    known = plate.known.numpy()
    bare = (known & (matte.numpy() < BARE)).astype(np.float32)
    red, green, blue = np.moveaxis(cv2.absdiff(frame.numpy(), plate.picture.numpy()), -1, 0)
    apart = ((red.astype(np.uint16) + green + blue) / 3).astype(np.float32)
    weight = cv2.blur(bare, window, borderType=cv2.BORDER_CONSTANT)
    mean = cv2.blur(apart * bare, window, borderType=cv2.BORDER_CONSTANT) / weight.clip(1e-6)
    # Deep inside the person there is nothing bare around; there the plate is not needed.
    agrees: Bool[np.ndarray, "H W"] = known & (weight > 1e-3) & (mean < AGREEMENT)
    return Plate(torch.where(torch.from_numpy(agrees)[..., None], plate.picture, 0),
                 torch.from_numpy(agrees))  # fmt: skip
