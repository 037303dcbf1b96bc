"""Single pictures as files.

Conventions. Pictures are [H,W,3], 8-bit sRGB, rows from top to bottom. Files hold nothing but the
picture, so equal pictures are equal bytes.
"""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from deblur_avatar.errors import ArtifactError

JPEG_QUALITY = 90  # of 100: compression is not seen beside what is being shown


def write_picture(path: Path, picture: UInt8[np.ndarray, "H W 3"]) -> None:
    """Write a PNG file in one move.

    Raises:
        ArtifactError: if the disk refuses.
    """
    path = Path(path)
    scratch = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch.write_bytes(encoded(picture, ".png"))
        scratch.replace(path)
    except OSError as error:
        raise ArtifactError(f"cannot write {path}: {error}") from error


def read_picture(path: Path) -> UInt8[np.ndarray, "H W 3"]:
    """Read any picture file as 8-bit colours.

    Raises:
        ArtifactError: if it is missing or is no picture.
    """
    try:
        content = np.frombuffer(Path(path).read_bytes(), np.uint8)
    except OSError as error:
        raise ArtifactError(f"cannot read {path}: {error.strerror}") from None
    picture = cv2.imdecode(content, cv2.IMREAD_COLOR) if content.size else None
    if picture is None:
        raise ArtifactError(f"{path} is not a picture; run `dvc repro` or `dvc pull`")
    return np.ascontiguousarray(picture[..., ::-1])


def encoded(picture: UInt8[np.ndarray, "H W 3"], suffix: str) -> bytes:
    """The bytes of a `.png` or `.jpg` file."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if suffix == ".jpg" else []
    done, content = cv2.imencode(suffix, np.ascontiguousarray(picture[..., ::-1]), quality)
    if not done:
        raise OSError(f"cannot encode a {suffix} picture of shape {picture.shape}")
    return content.tobytes()
