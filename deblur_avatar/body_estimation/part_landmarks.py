"""Hand and face landmarks (MediaPipe), looked for where a person's hands and head are.

A whole body's hands are too small for a detector of hands, so each is cut out and enlarged first.
Where nothing is found, as is usual under blur, nothing is said. F frames.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from scipy.ndimage import median_filter
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.body_estimation.quiet import quiet_stderr, wait_until_started

logger = logging.getLogger(__name__)

# Rows of MediaPipe's 33 landmarks, those of sides the left first.
ELBOWS, WRISTS, INDEX, LITTLE = (13, 14), (15, 16), (19, 20), (17, 18)
NOSE, EARS = 0, (7, 8)
HAND_COUNT = 21  # landmarks of MediaPipe's hand model
# Of MediaPipe's 468 of a face, those that no expression moves far: tip and root of the nose, the
# outer corners of the eyes (the person's left first), top of the forehead, the sides before the
# ears (left first), chin.
FACE_NOSE = 1
FACE_ROWS = (FACE_NOSE, 168, 263, 33, 10, 454, 234, 152)

HAND_BOX, FACE_BOX = 0.22, 0.26  # sides of what is cut out, as shares of the person's size
HAND_REACH = 2.8  # sides of a hand's box, in lengths from the wrist to the roots of fingers
PALM = 0.4  # of the forearm: from the wrist to the roots of fingers, where they are not marked
BOX_PIXELS = 256  # to which boxes are enlarged
SMALLEST = 100.0  # pixels of a person's size below which hands and face have too few to be found
SURE = 0.3  # confidence from which MediaPipe says that there is a hand or a face
STEADY = 25  # frames over which a person's size is one


@dataclass(frozen=True)
class PartLandmarks:
    """Hands and face of one person in F frames of one camera.

    Places are pixels right and down, and away from the camera in the same unit, from where it may
    be. Hands are by the wrist they were looked for at, the left one first; zero where none was
    found.
    """

    hands: Float[Tensor, "F 2 21 3"]
    left: Float[Tensor, "F 2"]  # how sure it is that a hand is a left one; 0.5: not at all
    hand_found: Bool[Tensor, "F 2"]
    face: Float[Tensor, "F Q 3"]  # `FACE_ROWS`
    face_found: Bool[Tensor, " F"]
    sizes: Float[Tensor, " F"]  # of the person in the picture, pixels: her box's longer side


class _Box(NamedTuple):
    """A square of a frame, enlarged."""

    picture: UInt8[np.ndarray, "S S 3"]
    corner: Float[np.ndarray, " 2"]  # pixels of the frame
    side: float  # pixels of the frame

    def in_frame(self, marks: Any) -> Float[np.ndarray, "N 3"]:
        """A detector's landmarks in pixels; their depth is of the same unit and about its own."""
        places = np.array([(mark.x, mark.y, mark.z) for mark in marks]) * self.side
        places[:, :2] += self.corner
        return places


def detect_parts(
    frames: UInt8[Tensor, "F H W 3"],
    points: Float[Tensor, "F L 2"],
    visibility: Float[Tensor, "F L"],
) -> PartLandmarks:
    """Find the hands and the face of a person whose landmarks are known.

    Args:
        frames: of one camera.
        points: MediaPipe's 33 landmarks, pixels.
        visibility: of them; 0 where the person, or what has no landmark, was not found.
    """
    count = len(frames)
    hands, face = np.zeros((count, 2, HAND_COUNT, 3)), np.zeros((count, len(FACE_ROWS), 3))
    left, hand_found = np.full((count, 2), 0.5), np.zeros((count, 2), bool)
    face_found = np.zeros(count, bool)
    sizes = marked_sizes(points.numpy(), visibility.numpy() > 0)
    large = np.flatnonzero(sizes >= SMALLEST)
    if len(large) < count:
        logger.info(
            "hands and face are looked for in %d of %d frames; in the others the person is not "
            "found, or smaller than %d pixels",
            len(large),
            count,
            SMALLEST,
        )
    if len(large):
        with _models() as (hand_model, face_model):
            for index in run.progress(large.tolist(), "hands and face"):
                frame, marks = frames[index].numpy(), points[index].numpy()
                marked = visibility[index].numpy() > 0
                boxes = [_hand_box(frame, marks, marked, side, sizes[index]) for side in (0, 1)]
                head = _head_box(frame, marks, marked, sizes[index])
                with quiet_stderr():
                    found = [box and _hand(hand_model, box) for box in boxes]
                    meshes = head and face_model.process(head.picture).multi_face_landmarks
                for side, hand in enumerate(found):
                    if hand is not None:
                        hands[index, side], left[index, side] = hand
                        hand_found[index, side] = True
                if head and meshes:
                    face[index] = head.in_frame(meshes[0].landmark)[list(FACE_ROWS)]
                    face_found[index] = True
    return PartLandmarks(
        hands=torch.from_numpy(hands).float(),
        left=torch.from_numpy(left).float(),
        hand_found=torch.from_numpy(hand_found),
        face=torch.from_numpy(face).float(),
        face_found=torch.from_numpy(face_found),
        sizes=torch.from_numpy(sizes).float(),
    )


def marked_sizes(
    points: Float[np.ndarray, "F L 2"], marked: Bool[np.ndarray, "F L"]
) -> Float[np.ndarray, " F"]:
    """The longer side of a person's box, lying or standing, steady over time; 0: not found.

    Args:
        points: landmarks, pixels.
        marked: which of them the detector has: some know fewer than MediaPipe's.
    """
    low = np.where(marked[..., None], points, np.inf).min(1)
    high = np.where(marked[..., None], points, -np.inf).max(1)
    found = np.flatnonzero(marked.any(1))
    sizes = np.zeros(len(points))
    if len(found):
        longer = (high[found] - low[found]).max(1)
        sizes[found] = median_filter(longer, min(STEADY, 2 * len(found) - 1), mode="nearest")
    return sizes


@contextmanager
def _models() -> Iterator[tuple[Any, Any]]:
    with quiet_stderr():
        from mediapipe.python.solutions.face_mesh import FaceMesh
        from mediapipe.python.solutions.hands import Hands

        hands = Hands(static_image_mode=True, max_num_hands=1, min_detection_confidence=SURE)
        face = FaceMesh(static_image_mode=True, max_num_faces=1, min_detection_confidence=SURE)
        for detector in (hands, face):
            wait_until_started(detector)
    with hands, face:
        yield hands, face


def _hand_box(
    frame: UInt8[np.ndarray, "H W 3"],
    marks: Float[np.ndarray, "L 2"],
    marked: Bool[np.ndarray, " L"],
    side: int,
    size: float,
) -> _Box | None:
    """About the roots of the fingers, or where the forearm points to; None without a wrist."""
    if not marked[WRISTS[side]]:
        return None
    wrist = marks[WRISTS[side]]
    if marked[[INDEX[side], LITTLE[side]]].all():
        roots = (marks[INDEX[side]] + marks[LITTLE[side]]) / 2
    elif marked[ELBOWS[side]]:
        roots = wrist + PALM * (wrist - marks[ELBOWS[side]])
    else:
        roots = wrist
    length = float(np.linalg.norm(roots - wrist))
    return _box(frame, roots, max(HAND_BOX * size, HAND_REACH * length))


def _head_box(
    frame: UInt8[np.ndarray, "H W 3"],
    marks: Float[np.ndarray, "L 2"],
    marked: Bool[np.ndarray, " L"],
    size: float,
) -> _Box | None:
    """About what is marked of nose and ears; None if nothing is."""
    rows = [row for row in (NOSE, *EARS) if marked[row]]
    return _box(frame, marks[rows].mean(0), FACE_BOX * size) if rows else None


def _box(frame: UInt8[np.ndarray, "H W 3"], centre: Float[np.ndarray, " 2"], side: float) -> _Box:
    """A square about a point, black where it leaves the frame."""
    corner = np.asarray(centre, np.float64) - side / 2
    scale = BOX_PIXELS / side
    move = np.hstack([np.eye(2) * scale, (0.5 * scale - 0.5 - corner * scale)[:, None]])
    picture = cv2.warpAffine(frame, move, (BOX_PIXELS, BOX_PIXELS), flags=cv2.INTER_CUBIC)
    return _Box(picture, corner, side)


def _hand(model: Any, box: _Box) -> tuple[Float[np.ndarray, "21 3"], float] | None:
    """Places of a hand in pixels, and how sure it is that it is a left one."""
    seen = model.process(box.picture)
    if not seen.multi_hand_landmarks:
        return None
    places = box.in_frame(seen.multi_hand_landmarks[0].landmark)
    metres = np.array(
        [(mark.x, mark.y, mark.z) for mark in seen.multi_hand_world_landmarks[0].landmark]
    )
    # The model of metres knows depth better; it has no scale in the picture of its own.
    spread = places[:, :2] - places[:, :2].mean(0)
    metres = metres - metres.mean(0)
    places[:, 2] = metres[:, 2] * np.linalg.norm(spread) / np.linalg.norm(metres[:, :2]).clip(1e-6)
    side = seen.multi_handedness[0].classification[0]
    # MediaPipe takes pictures for mirrored ones: what it calls right is a left hand.
    return places, side.score if side.label == "Right" else 1 - side.score
