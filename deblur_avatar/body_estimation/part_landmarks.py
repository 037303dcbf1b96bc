"""Hand and face landmarks (MediaPipe), looked for where a person's wrists and head are.

A whole body's hands are too small for a detector of hands, so each is cut out and enlarged first.
Where nothing is found, as is usual under blur, nothing is said. F frames.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.body_estimation.quiet import quiet_stderr

# Rows of MediaPipe's 33 landmarks: wrist and the roots of index and little finger, by side.
WRISTS, INDEX, LITTLE = (15, 16), (19, 20), (17, 18)
HEAD = (0, 7, 8)  # nose and ears
HAND_COUNT = 21  # landmarks of MediaPipe's hand model
# Of MediaPipe's 468 of a face, those that no expression moves far: tip and root of the nose,
# the outer corners of the eyes (the person's left first), top of the forehead, the sides before
# the ears (left first), chin.
FACE_ROWS = (1, 168, 263, 33, 10, 454, 234, 152)

HAND_BOX, FACE_BOX = 0.22, 0.26  # sides of what is cut out, as shares of the person's height
HAND_REACH = 2.8  # sides of a hand's box, in lengths from the wrist to the roots of fingers
BOX_PIXELS = 256  # to which boxes are enlarged
SMALLEST = 100.0  # pixels of a person's height below which hands have none to tell
SURE = 0.3  # confidence from which MediaPipe says that there is a hand or a face


@dataclass(frozen=True)
class PartLandmarks:
    """Hands and face of one person in F frames of one camera.

    Places are pixels right, down and, relative to the part's own middle, away from the camera.
    Hands are by where they were looked for, the left wrist first; zero where none was found.
    """

    hands: Float[Tensor, "F 2 21 3"]
    left: Float[Tensor, "F 2"]  # how sure it is that a hand is a left one; 0.5: not at all
    hand_found: Bool[Tensor, "F 2"]
    face: Float[Tensor, "F Q 3"]  # `FACE_ROWS`
    face_found: Bool[Tensor, " F"]


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
    found: Bool[Tensor, " F"],
) -> PartLandmarks:
    """Find the hands and the face of a person whose landmarks are known.

    Args:
        frames: of one camera.
        points: MediaPipe's 33 landmarks, pixels.
        found: frames in which there are any.
    """
    count = len(frames)
    hands, face = np.zeros((count, 2, HAND_COUNT, 3)), np.zeros((count, len(FACE_ROWS), 3))
    left, hand_found = np.full((count, 2), 0.5), np.zeros((count, 2), bool)
    face_found = np.zeros(count, bool)
    rows = points[found][..., 1]
    height = float((rows.amax(1) - rows.amin(1)).median()) if bool(found.any()) else 0.0
    if height >= SMALLEST:
        with _models() as (hand_model, face_model):
            for index in run.progress(range(count), "hands and face"):
                if not found[index]:
                    continue
                frame, marks = frames[index].numpy(), points[index].numpy()
                boxes = [_hand_box(frame, marks, side, height) for side in (0, 1)]
                head = _box(frame, marks[list(HEAD)].mean(0), FACE_BOX * height)
                with quiet_stderr():
                    seen = [_hand(hand_model, box) for box in boxes]
                    meshes = face_model.process(head.picture).multi_face_landmarks
                for side, hand in enumerate(seen):
                    if hand is not None:
                        hands[index, side], left[index, side] = hand
                        hand_found[index, side] = True
                if meshes:
                    face[index] = head.in_frame(meshes[0].landmark)[list(FACE_ROWS)]
                    face_found[index] = True
    return PartLandmarks(
        hands=torch.from_numpy(hands).float(),
        left=torch.from_numpy(left).float(),
        hand_found=torch.from_numpy(hand_found),
        face=torch.from_numpy(face).float(),
        face_found=torch.from_numpy(face_found),
    )


@contextmanager
def _models() -> Iterator[tuple[Any, Any]]:
    with quiet_stderr():
        from mediapipe.python.solutions.face_mesh import FaceMesh
        from mediapipe.python.solutions.hands import Hands

        hands = Hands(static_image_mode=True, max_num_hands=1, min_detection_confidence=SURE)
        face = FaceMesh(static_image_mode=True, max_num_faces=1, min_detection_confidence=SURE)
    with hands, face:
        yield hands, face


def _hand_box(
    frame: UInt8[np.ndarray, "H W 3"], marks: Float[np.ndarray, "L 2"], side: int, height: float
) -> _Box:
    wrist = marks[WRISTS[side]]
    roots = (marks[INDEX[side]] + marks[LITTLE[side]]) / 2
    length = float(np.linalg.norm(roots - wrist))
    return _box(frame, roots, max(HAND_BOX * height, HAND_REACH * length))


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
