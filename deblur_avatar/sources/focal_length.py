"""Focal length from metadata or a field of view.

Conventions. A focal length in pixels belongs to one size of picture, the size as recorded. The
35 mm equivalent is about a picture's diagonal, 43.27 mm on film (CIPA DCG-001).
"""

import math
import re
from pathlib import Path

from deblur_avatar.errors import ArtifactError
from deblur_avatar.readers.picture_codec import read_attribute
from deblur_avatar.sources.footage import PICTURES, files_in_order
from deblur_avatar.sources.video_files import container_metadata

FILM_DIAGONAL = math.hypot(36.0, 24.0)  # millimetres
EQUIVALENT = re.compile(r"focal.?length.*35", re.IGNORECASE)  # in a container: Apple's, Sony's
FOCAL_ON_FILM = "Exif:FocalLengthIn35mmFilm"  # millimetres
SHORTEST, LONGEST = 6.0, 600.0  # millimetres; beyond these the entry is a mistake


def focal_of_files(path: Path, size: tuple[int, int]) -> float | None:
    """Pixels, from a video's metadata or the first picture's EXIF; None if they do not say.

    Args:
        path: a video, or a folder of pictures.
        size: width and height as recorded, pixels.
    """
    millimetres = _of_pictures(path) if path.is_dir() else _of_video(path)
    if millimetres is None or not SHORTEST <= millimetres <= LONGEST:
        return None
    return millimetres / FILM_DIAGONAL * math.hypot(*size)


def focal_of_view(degrees: float, size: tuple[int, int]) -> float:
    """Pixels, of a camera whose longer side sees an angle."""
    return max(size) / 2 / math.tan(math.radians(degrees) / 2)


def _of_pictures(folder: Path) -> float | None:
    pictures = files_in_order(folder, PICTURES)
    try:
        return _number(read_attribute(pictures[0], FOCAL_ON_FILM)) if pictures else None
    except ArtifactError:  # said by whoever reads the picture
        return None


def _of_video(path: Path) -> float | None:
    entries = container_metadata(path)
    return next((_number(v) for k, v in entries.items() if EQUIVALENT.search(k)), None)


def _number(value: object) -> float | None:
    found = re.search(r"\d+(\.\d+)?", str(value)) if value is not None else None
    return float(found[0]) if found else None
