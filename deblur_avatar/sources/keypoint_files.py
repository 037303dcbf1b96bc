"""Given keypoints: OpenPose or COCO files, as the detector here would give them.

Understood are OpenPose's JSON (one file a frame in a folder, or one file holding a list of such
frames; BODY_25 or COCO-18) and COCO's (a list of detections, or one under `annotations`; 17
points; `image_id` is a frame number or a file name that ends in one). Each file or entry is for
one frame of the footage, counted from 0. What comes out are MediaPipe's 33 landmarks, pixels of
the footage as recorded, and a confidence in [0, 1]; landmarks that the format has not stay at 0.

Where several people were found, they are followed from frame to frame by their boxes, and the one
whose heights add up to most is taken: the larger, longer-tracked one.
"""

import json
import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from deblur_avatar.errors import ArtifactError
from deblur_avatar.sources.footage import files_in_order

logger = logging.getLogger(__name__)

Person = Float[np.ndarray, "33 3"]  # x, y, confidence

COUNT = 33  # landmarks of MediaPipe
# MediaPipe's landmark of each point: nose, eyes, ears, shoulders, elbows, wrists, hips, knees,
# ankles.
_COCO_17 = dict(enumerate((0, 2, 5, 7, 8, 11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28)))
_COCO_18 = {
    0: 0, 2: 12, 3: 14, 4: 16, 5: 11, 6: 13, 7: 15, 8: 24, 9: 26, 10: 28, 11: 23, 12: 25, 13: 27,
    14: 5, 15: 2, 16: 8, 17: 7,
}  # fmt: skip
_BODY_25 = {
    0: 0, 2: 12, 3: 14, 4: 16, 5: 11, 6: 13, 7: 15, 9: 24, 10: 26, 11: 28, 12: 23, 13: 25, 14: 27,
    15: 5, 16: 2, 17: 8, 18: 7, 19: 31, 21: 29, 22: 32, 24: 30,
}  # fmt: skip
_FORMATS = {17: _COCO_17, 18: _COCO_18, 25: _BODY_25}
MAX_FRAMES = 10_000_000  # 46 hours at 60 frames a second
MAX_VALUE = 1e6  # pixels
FEWEST = 5  # points that make a person
FURTHEST = 0.5  # of a person's height, that she moves between two frames


def read_keypoints(path: Path) -> list[list[Person]]:
    """People by frame, as the files have them.

    Raises:
        ArtifactError: if nothing is there, it is no JSON, or of neither format.
    """
    if path.is_dir():
        files = files_in_order(path, (".json",))
        if not files:
            raise ArtifactError(f"{path} holds no .json files, one a frame; check clip.keypoints")
        return [_openpose(_json(file), file) for file in files]
    content = _json(path)
    if isinstance(content, dict) and "annotations" in content:
        content = content["annotations"]
    if isinstance(content, dict) and "people" in content:
        content = [content]
    if not isinstance(content, list) or not content:
        raise ArtifactError(f"{path} is neither OpenPose's nor COCO's JSON: no list of frames")
    if isinstance(content[0], dict) and "people" in content[0]:
        return [_openpose(frame, path) for frame in content]
    return _coco(content, path)


def follow_person(frames: list[list[Person]], where: str) -> Float[np.ndarray, "F 33 3"]:
    """The larger, longer-tracked person of all frames; zeros where she was not found."""
    tracks: list[dict[int, Person]] = []
    for index, people in enumerate(frames):
        free = list(tracks)
        for person in sorted(people, key=_height, reverse=True):
            near = [t for t in free if _distance(t[max(t)], person) < FURTHEST * _height(person)]
            if near:
                track = min(near, key=lambda t: _distance(t[max(t)], person))
                free = [other for other in free if other is not track]
            else:
                track = {}
                tracks.append(track)
            track[index] = person
    chosen = np.zeros((len(frames), COUNT, 3), np.float32)
    if not tracks:
        return chosen
    tracks.sort(key=lambda track: -sum(map(_height, track.values())))
    for index, person in tracks[0].items():
        chosen[index] = person
    others = [track for track in tracks[1:] if 2 * len(track) > len(tracks[0])]
    if others:
        logger.warning(
            "%s: %d people; the larger, longer-tracked one is taken, seen in %d frames",
            where,
            1 + len(others),
            len(tracks[0]),
        )
    return chosen


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except OSError as error:
        raise ArtifactError(f"cannot read {path}: {error.strerror}; check clip.keypoints") from None
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"{path} is not JSON: {error}") from None


def _openpose(frame: Any, where: Path) -> list[Person]:
    try:
        return [_person(entry["pose_keypoints_2d"], where) for entry in frame["people"]]
    except (KeyError, TypeError) as error:
        raise ArtifactError(f"{where} is not OpenPose's JSON: lacks {error}") from None


def _coco(entries: list[Any], where: Path) -> list[list[Person]]:
    frames: dict[int, list[Person]] = {}
    for entry in entries:
        try:
            frame, points = _frame_number(entry["image_id"]), entry["keypoints"]
        except (KeyError, TypeError) as error:
            raise ArtifactError(f"{where} is neither OpenPose's nor COCO's JSON: {error}") from None
        if frame is None:
            raise ArtifactError(
                f"{where}: image_id {entry['image_id']!r:.60} holds no frame number up to "
                f"{MAX_FRAMES}"
            )
        frames.setdefault(frame, []).append(_person(points, where))
    return [frames.get(index, []) for index in range(max(frames) + 1)]


def _frame_number(image: object) -> int | None:
    if not isinstance(image, str | int):
        return None
    found = re.findall("[0-9]+", Path(str(image)[-200:]).stem)
    number = int(found[-1]) if found else MAX_FRAMES + 1
    return number if number <= MAX_FRAMES else None


def _person(numbers: Any, where: Path) -> Person:
    try:
        points = np.asarray(numbers, np.float32).reshape(-1, 3)
    except (ValueError, TypeError, OverflowError):
        raise ArtifactError(f"{where}: keypoints must be x, y, confidence for each point") from None
    if len(points) not in _FORMATS:
        raise ArtifactError(
            f"{where}: {len(points)} points a person, known are 17 (COCO), 18 and 25 (OpenPose)"
        )
    if not (abs(points) <= MAX_VALUE).all():
        raise ArtifactError(
            f"{where}: keypoints must be pixels: finite numbers under {MAX_VALUE:g}"
        )
    person = np.zeros((COUNT, 3), np.float32)
    for source, landmark in _FORMATS[len(points)].items():
        person[landmark] = points[source]
    # COCO's annotations write 1 for hidden and 2 for seen.
    person[:, 2] = (person[:, 2] / (2 if person[:, 2].max() > 1 else 1)).clip(0, 1)
    return person if (person[:, 2] > 0).sum() >= FEWEST else np.zeros_like(person)


def _seen(person: Person) -> Float[np.ndarray, "K 2"]:
    return person[person[:, 2] > 0, :2]


def _height(person: Person) -> float:
    seen = _seen(person)
    return float(np.ptp(seen[:, 1])) if len(seen) else 0.0


def _distance(a: Person, b: Person) -> float:
    first, second = _seen(a), _seen(b)
    if not len(first) or not len(second):
        return float("inf")
    return float(np.linalg.norm(first.mean(0) - second.mean(0)))
