"""Picture files: single pictures and stacks of them, read and written.

Conventions. Pictures are [H,W,3], 8-bit sRGB, rows from top to bottom. Files that are written hold
nothing but the picture, so equal pictures are equal bytes. Whatever is read becomes that too,
whatever its bits, channels, orientation and colour space.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Integer, UInt8

from deblur_avatar.errors import ArtifactError
from deblur_avatar.imaging.color import linear_to_srgb
from deblur_avatar.readers.picture_codec import (
    HALF_EXR,
    JPEG,
    QUICK_PNG,
    damaged,
    encoded,
    palette_indices,
    read_pixels,
)


def write_picture(path: Path, picture: UInt8[np.ndarray, "H W 3"]) -> None:
    """Write a PNG file in one move.

    Raises:
        ArtifactError: if the disk refuses.
    """
    _write(Path(path), picture, ".png", QUICK_PNG)


def write_light(path: Path, light: Float[np.ndarray, "H W 3"]) -> None:
    """Write linear light as an EXR file of half-precision numbers, in one move.

    Raises:
        ArtifactError: if the disk refuses.
    """
    _write(Path(path), light, ".exr", HALF_EXR)


def jpeg_bytes(picture: UInt8[np.ndarray, "H W 3"]) -> bytes:
    """What a JPEG file of a picture holds."""
    return encoded(picture, ".jpg", JPEG)


def read_picture(path: Path) -> UInt8[np.ndarray, "H W 3"]:
    """Read any picture file as 8-bit colours, turned as its camera says it should be seen.

    Grey becomes three equal channels, of 16 bits the upper 8 are kept, linear light is encoded as
    sRGB, CMYK is converted without a profile, and what is transparent shows black.

    Raises:
        ArtifactError: if it is missing, damaged, too large or no picture.
    """
    path = Path(path)
    found = read_pixels(path)
    if found.linear:
        return _of_light(path, found.values, found.alpha)
    if found.values.dtype not in (np.uint8, np.uint16):
        raise damaged(path, f"its values are {found.values.dtype} numbers, wanted 8 or 16 bits")
    codes = (found.values >> 8).astype(np.uint8) if found.values.itemsize == 2 else found.values
    if found.alpha:
        deep = codes.astype(np.uint16)
        codes = ((deep[..., :-1] * deep[..., -1:] + 127) // 255).astype(np.uint8)
    return _three_channels(codes)


def read_mask(path: Path) -> Bool[np.ndarray, "H W"]:
    """Read a mask file: true where the value is not 0, whatever labels or palette it uses.

    Raises:
        ArtifactError: if it is missing, damaged, too large or no picture.
    """
    return read_labels(path)[0] != 0


def read_labels(path: Path) -> tuple[Integer[np.ndarray, "H W"], bool]:
    """Read a mask's values as they are stored, 0 where it is transparent.

    In a file with a palette the values are the indices, not their colours; of several channels the
    largest counts. Of 16 bits, where any value needs more than 8, 8 are made, rounded up: what is
    not 0 stays so.

    Returns:
        The values, and whether they are opaque greys of 8 bits, in equal channels if in several:
        these may be coverage rather than labels.

    Raises:
        ArtifactError: if it is missing, damaged, too large or no picture.
    """
    path = Path(path)
    found = read_pixels(path)
    if found.palette:
        return palette_indices(path), False
    if found.values.dtype.kind not in "ui":
        raise damaged(path, f"its values are {found.values.dtype} numbers, wanted integers")
    channels = found.values[..., : found.values.shape[2] - found.alpha]
    values = channels.max(-1)
    grey = bool((channels == values[..., None]).all())
    if found.alpha:
        opacity = found.values[..., -1]
        values = np.where(opacity > 0, values, 0)
        grey &= bool((opacity == np.iinfo(opacity.dtype).max).all())
    if values.dtype == np.uint16 and values.max() > 255:
        values = ((values.astype(np.uint32) + 256) // 257).astype(np.uint8)
    return values, grey and values.dtype == np.uint8


def _write(path: Path, pixels: np.ndarray, suffix: str, options: Mapping[str, object]) -> None:
    scratch = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch.write_bytes(encoded(pixels, suffix, options))
        scratch.replace(path)
    except OSError as error:
        raise ArtifactError(f"cannot write {path}: {error}") from error


def _of_light(path: Path, values: np.ndarray, alpha: bool) -> UInt8[np.ndarray, "H W 3"]:
    """The sRGB codes of linear light; what is brighter than white becomes white."""
    whole = np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1
    light = values.astype(np.float32) / np.float32(whole)
    if not np.isfinite(light).all():
        raise damaged(path, "it holds values that are not finite")
    if alpha:
        light = light[..., :-1] * light[..., -1:]
    srgb = linear_to_srgb(torch.from_numpy(light.clip(0, 1)))
    return _three_channels((srgb * 255).round().to(torch.uint8).numpy())


def _three_channels(codes: UInt8[np.ndarray, "H W C"]) -> UInt8[np.ndarray, "H W 3"]:
    return codes if codes.shape[2] == 3 else np.repeat(codes[..., :1], 3, axis=2)
