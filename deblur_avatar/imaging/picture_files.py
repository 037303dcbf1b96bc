"""Single pictures as files.

Conventions. Pictures are [H,W,3], 8-bit sRGB, rows from top to bottom. Files that are written hold
nothing but the picture, so equal pictures are equal bytes. Whatever is read becomes that too: this
is the one place where pictures and masks of others are decoded.
"""

import io
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from PIL import ExifTags, Image, ImageOps, UnidentifiedImageError

from deblur_avatar.errors import ArtifactError

T = TypeVar("T")

# Not PostScript, which Pillow would hand to Ghostscript to run.
FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "PPM", "GIF")
JPEG_QUALITY = 90  # of 100: compression is not seen beside what is being shown
MAX_PIXELS = 100_000_000  # a small file can unfold to any size; this is 300 MB
SIXTEEN_BITS = ("I;16", "I;16B", "I;16L", "I")  # Pillow's modes of grey pictures


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
    """Read any picture file as 8-bit colours, turned as its camera says it should be seen.

    Grey becomes three equal channels, of 16 bits the upper 8 are kept, CMYK is converted without a
    profile, and what is transparent shows black.

    Raises:
        ArtifactError: if it is missing, damaged, too large or no picture.
    """
    return _decoded(Path(path), lambda image: _as_rgb(ImageOps.exif_transpose(image)))


def read_mask(path: Path) -> Bool[np.ndarray, "H W"]:
    """Read a mask file: true where the value is not 0, whatever labels or palette it uses.

    In a file with a palette the values are the indices, not their colours; in one with several
    channels any colour that is not black counts, unless it is transparent.

    Raises:
        ArtifactError: if it is missing, damaged, too large or no picture.
    """
    return _decoded(Path(path), _nonzero)


def read_values(path: Path) -> tuple[np.ndarray, str]:
    """Read a picture's values as they are stored, and Pillow's name for what they mean.

    Raises:
        ArtifactError: if it is missing, damaged, too large or no picture.
    """
    return _decoded(Path(path), lambda image: (np.array(image), image.mode))


def read_exif(path: Path) -> dict[int, Any]:
    """What a camera wrote about how it took a picture, by the numbers of EXIF.

    Raises:
        ArtifactError: if it is missing, damaged, too large or no picture.
    """
    return _decoded(Path(path), lambda image: image.getexif().get_ifd(ExifTags.IFD.Exif))


def encoded(picture: UInt8[np.ndarray, "H W 3"], suffix: str) -> bytes:
    """The bytes of a `.png` or `.jpg` file."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if suffix == ".jpg" else []
    done, content = cv2.imencode(suffix, np.ascontiguousarray(picture[..., ::-1]), quality)
    if not done:
        raise OSError(f"cannot encode a {suffix} picture of shape {picture.shape}")
    return content.tobytes()


def _decoded(path: Path, convert: Callable[[Image.Image], T]) -> T:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ArtifactError(f"cannot read {path}: {error.strerror}") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the limit below
            image = Image.open(io.BytesIO(content), formats=FORMATS)
        width, height = image.size
        if width * height > MAX_PIXELS:
            raise ArtifactError(
                f"{path} unfolds to {width} x {height} pixels, at most {MAX_PIXELS // 10**6} "
                "million are read; scale it down"
            )
        return convert(image)
    except ArtifactError:
        raise
    except UnidentifiedImageError:
        reason = "of no known kind" if content else "an empty file"
    except Exception as error:
        # A damaged picture can raise nearly anything from inside its decoder.
        reason = str(error) or repr(error)
    raise ArtifactError(
        f"{path} is not a picture that can be read: {reason}; copy or make it again "
        "(`dvc repro` or `dvc pull` for those of the pipeline)"
    )


def _as_rgb(image: Image.Image) -> UInt8[np.ndarray, "H W 3"]:
    if image.mode in SIXTEEN_BITS:
        upper = (np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
        return np.repeat(upper[..., None], 3, axis=2)
    if image.mode == "F":
        raise ValueError("its values are floating-point numbers, wanted 8 or 16 bits")
    if not image.has_transparency_data:
        return np.array(image.convert("RGB"))
    pixels = np.asarray(image.convert("RGBA")).astype(np.uint16)
    return ((pixels[..., :3] * pixels[..., 3:] + 127) // 255).astype(np.uint8)


def _nonzero(image: Image.Image) -> Bool[np.ndarray, "H W"]:
    values = np.asarray(image)
    if image.mode == "CMYK":
        values = np.asarray(image.convert("RGB"))
    if values.ndim == 2:
        return values != 0
    if image.mode in ("LA", "PA", "RGBA"):
        return (values[..., :-1] != 0).any(-1) & (values[..., -1] != 0)
    return (values != 0).any(-1)
