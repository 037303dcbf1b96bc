"""Camera motion: how far the background moves across the picture, which says if it stood still."""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

STILL = 0.01  # of the picture's width, that the background of a still camera may move
CORNERS = 300  # features followed from one sampled frame to the next
SAMPLES = 12  # frames
FEWEST = 12  # features that must be followed for their motion to mean something
PERSON_MARGIN = 0.03  # of the picture's height, around masks, that is no background


def background_travel(
    frames: UInt8[Tensor, "F H W 3"], mattes: UInt8[Tensor, "F H W"]
) -> float | None:
    """Longest way of the background, as a share of the picture's width.

    Features are followed from each of a few frames to the next; the median of their steps is the
    background's, since what else moves in it (leaves, passers-by) is less. Ways add up, so that
    slow drifts count.

    Returns:
        None if the background has too little to follow.
    """
    chosen = np.linspace(0, len(frames) - 1, min(SAMPLES, len(frames))).round().astype(int)
    greys = [cv2.cvtColor(frames[i].numpy(), cv2.COLOR_RGB2GRAY) for i in chosen]
    open_ = [background_mask(mattes[i]).numpy().astype(np.uint8) for i in chosen]
    place, places = np.zeros(2), [np.zeros(2)]
    for index in range(1, len(chosen)):
        step = _step(greys[index - 1], greys[index], open_[index - 1])
        if step is None:
            return None
        place = place + step
        places.append(place)
    way = np.array(places)
    return float(np.linalg.norm(way[:, None] - way[None], axis=-1).max() / frames.shape[2])


def background_mask(matte: UInt8[Tensor, "H W"]) -> Bool[Tensor, "H W"]:
    """What is surely not the person."""
    radius = max(1, round(PERSON_MARGIN * matte.shape[0]))
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return torch.from_numpy(cv2.dilate((matte.numpy() > 0).astype(np.uint8), kernel) == 0)


def _step(
    before: UInt8[np.ndarray, "H W"],
    after: UInt8[np.ndarray, "H W"],
    mask: UInt8[np.ndarray, "H W"],
) -> np.ndarray | None:
    corners = cv2.goodFeaturesToTrack(before, CORNERS, 0.01, 7, mask=mask)
    if corners is None or len(corners) < FEWEST:
        return None
    corners = np.asarray(corners)
    moved, found = _followed(before, after, corners)
    back, returned = _followed(after, before, moved)
    kept = found & returned & (np.linalg.norm((back - corners)[:, 0], axis=-1) < 1)
    if kept.sum() < FEWEST:
        return None
    return np.asarray(np.median((moved - corners)[kept, 0], axis=0))


def _followed(
    before: UInt8[np.ndarray, "H W"], after: UInt8[np.ndarray, "H W"], corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where features went, and which of them were found again."""
    moved, found, _ = cv2.calcOpticalFlowPyrLK(before, after, corners, np.zeros_like(corners))
    return np.asarray(moved), np.asarray(found)[:, 0] == 1
