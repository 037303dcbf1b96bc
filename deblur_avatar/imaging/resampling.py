"""Image resampling: lens distortion taken out, crops, scaling.

Conventions. A crop is (x, y, width, height) in whole pixels of the picture it is taken from. Pixel
centres lie at half-integers (`geometry.cameras`), so that cutting and scaling act on intrinsics as
they act on pictures.
"""

from collections.abc import Callable

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from deblur_avatar.run import in_threads

Crop = tuple[int, int, int, int]

PIXEL_CENTRE = 0.5  # of the top left pixel in our intrinsics; OpenCV puts it at 0


def undistort(
    images: UInt8[Tensor, "F H W *channels"],
    K: Float[Tensor, "3 3"],
    distortion: Float[Tensor, " 5"],
) -> UInt8[Tensor, "F H W *channels"]:
    """Straighten the pictures of one camera; K is kept.

    Args:
        images: of one camera.
        K: of the camera, pixels.
        distortion: OpenCV's (k1, k2, p1, p2, k3); all zero returns the very pictures.

    Returns:
        Pinhole pictures of the same size, black where the camera saw nothing.
    """
    if not distortion.any():
        return images
    height, width = images.shape[1:3]
    matrix = K.double().numpy().copy()
    matrix[:2, 2] -= PIXEL_CENTRE
    maps = cv2.initUndistortRectifyMap(
        matrix, distortion.double().numpy(), None, matrix, (width, height), cv2.CV_16SC2
    )
    return _each(images, lambda image: cv2.remap(image, *maps, cv2.INTER_LINEAR))


def crop_and_scale(
    images: UInt8[Tensor, "F H W *channels"],
    crop: Crop,
    size: tuple[int, int],
) -> UInt8[Tensor, "F h w *channels"]:
    """Cut a crop out of every picture and scale it.

    Args:
        images: of one camera.
        crop: x, y, width, height; must lie inside the pictures.
        size: width and height wanted; the crop's own size returns its pixels unchanged.

    Raises:
        ValueError: if the crop leaves the pictures.
    """
    x, y, width, height = crop
    if min(x, y) < 0 or y + height > images.shape[1] or x + width > images.shape[2]:
        raise ValueError(
            f"crop {crop} leaves pictures of {images.shape[2]} x {images.shape[1]} pixels"
        )
    cut = images[:, y : y + height, x : x + width]
    if (width, height) == tuple(size):
        return cut
    return _each(cut, lambda image: cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def crop_and_scale_intrinsics(
    K: Float[Tensor, "3 3"], crop: Crop, size: tuple[int, int]
) -> Float[Tensor, "3 3"]:
    """Intrinsics of the pictures that `crop_and_scale` returns; the true centre is kept."""
    x, y, width, height = crop
    changed = K.clone()
    changed[0, 2] -= x
    changed[1, 2] -= y
    changed[0] *= size[0] / width
    changed[1] *= size[1] / height
    return changed


def crop_around(boxes: Float[Tensor, "F 4"], margin: float, size: tuple[int, int]) -> Crop:
    """Find the smallest crop that holds all boxes with a margin, inside the picture.

    Args:
        boxes: left, top, right, bottom in pixels.
        margin: added on each side, as a share of the union's width and height.
        size: width and height of the picture.

    Raises:
        ValueError: if the boxes lie outside the picture.
    """
    low, high = boxes[:, :2].amin(0), boxes[:, 2:].amax(0)
    room = margin * (high - low)
    width, height = size
    left, top = (int(v) for v in (low - room).floor().clamp(min=0))
    right, bottom = (int(v) for v in (high + room).ceil())
    right, bottom = min(right, width), min(bottom, height)
    if right <= left or bottom <= top:
        raise ValueError(f"the person's box {boxes.tolist()[0]} lies outside {width} x {height}")
    return left, top, right - left, bottom - top


def _each(images: Tensor, change: Callable[[np.ndarray], np.ndarray]) -> Tensor:
    """Apply an OpenCV function to every picture."""
    changed = in_threads(lambda image: change(np.ascontiguousarray(image)), images.numpy())
    return torch.from_numpy(np.stack(changed))
