"""Camera motion: how far the background moves across the picture, which says if it stood still."""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from deblur_avatar.geometry.spacing import evenly_spaced

STILL = 0.01  # of the picture's width, that a corner of a still camera's background may move
CORNERS = 300  # features followed from one sampled frame to the next
SAMPLES = 12  # frames
FEWEST = 12  # features that must be followed for their motion to mean something
PERSON_MARGIN = 0.03  # of the picture's height, around masks, that is no background


def background_travel(
    frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"]
) -> float | None:
    """Longest way of a corner of the background, as a share of the picture's width.

    Features are followed from each of a few frames to the next, and a step is the similarity whose
    median distance to them is least: what else moves in the background (leaves, passers-by) is
    less. A shift alone does not do, since rolls and zooms about the middle of the picture cancel in
    it. RANSAC would follow any minority that moves as one, be it a logo; the least median needs
    half of the features, and no distance that depends on the picture's size.

    Steps are chained, so that slow drifts count. There are few of them however long the clip is,
    so that their noise adds up to little: beside a moving person, with noise of 6 to 12 codes, a
    camera that stands still travels 0.0001 to 0.0006.

    Returns:
        None if the background has too little to follow.
    """
    chosen = evenly_spaced(range(len(frames)), SAMPLES)
    greys = [cv2.cvtColor(frames[i].numpy(), cv2.COLOR_RGB2GRAY) for i in chosen]
    open_ = [background_mask(mattes[i]).numpy().astype(np.uint8) for i in chosen]
    height, width = mattes.shape[1:]
    corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]]).T
    now_from_first, places = np.eye(3), [corners]
    for index in range(1, len(chosen)):
        step = _step(greys[index - 1], greys[index], open_[index - 1])
        if step is None:
            return None
        now_from_first = step @ now_from_first
        places.append(now_from_first @ corners)
    ways = np.array(places)[:, :2]
    return float(np.linalg.norm(ways[:, None] - ways[None], axis=2).max() / width)


def background_mask(matte: UInt8[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    """What is surely not the person."""
    radius = max(1, round(PERSON_MARGIN * matte.shape[0]))
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return torch.from_numpy(cv2.dilate((matte.numpy() > 0).astype(np.uint8), kernel) == 0)


def _step(
    before: UInt8[np.ndarray, "H W"],
    after: UInt8[np.ndarray, "H W"],
    mask: UInt8[np.ndarray, "H W"],
) -> Float[np.ndarray, "3 3"] | None:
    """`after_from_before`, pixels: a similarity; None with too little to follow."""
    corners = cv2.goodFeaturesToTrack(before, CORNERS, 0.01, 7, mask=mask)
    if corners is None or len(corners) < FEWEST:
        return None
    corners = np.asarray(corners)
    moved, found = _followed(before, after, corners)
    back, returned = _followed(after, before, moved)
    kept = found & returned & (np.linalg.norm((back - corners)[:, 0], axis=-1) < 1)
    if kept.sum() < FEWEST:
        return None
    cv2.setRNGSeed(0)  # pairs of features are drawn
    step, _ = cv2.estimateAffinePartial2D(corners[kept], moved[kept], method=cv2.LMEDS)
    return None if step is None else np.vstack([step, [0, 0, 1]])


def _followed(
    before: UInt8[np.ndarray, "H W"], after: UInt8[np.ndarray, "H W"], corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where features went, and which of them were found again."""
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, after, corners, np.zeros_like(corners))
    return np.asarray(moved), np.asarray(found)[:, 0] == 1
