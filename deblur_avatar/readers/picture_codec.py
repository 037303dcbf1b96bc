"""Picture codecs: files to pixels and back by OpenImageIO; the one module that knows it.

Conventions. Pixels are [H,W,C] as the file stores them, turned as the file says they should be
seen. Encoded files hold nothing but the picture: what OpenImageIO adds to it (an empty EXIF block,
offsets, a date) is taken out, so equal pixels are equal bytes.
"""

import contextlib
import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray
from PIL import Image

from deblur_avatar.errors import ArtifactError

MAX_PIXELS = 100_000_000  # of one picture: a file of a few kB can unfold to any size
MAX_CHANNELS = 4  # colours and coverage
# What a file begins with, and OpenImageIO's name for it. It knows more kinds; none is wanted.
KINDS = {
    b"\x89PNG\r\n\x1a\n": "png", b"\xff\xd8\xff": "jpeg", b"II*\0": "tiff", b"MM\0*": "tiff",
    b"BM": "bmp", b"RIFF": "webp", b"P2": "pnm", b"P3": "pnm", b"P5": "pnm", b"P6": "pnm",
    b"v/1\x01": "openexr",
}  # fmt: skip
STORED_PNG = {
    "png:compressionLevel": 3
}  # of 9: within 5 % of the size of 9, in a tenth of the time
QUICK_PNG = {"compression": "rle", "png:filter": 16}  # libpng's filter `sub`
JPEG = {"Compression": "jpeg:90"}  # of 100: compression is not seen beside what is shown
HALF_EXR = {"compression": "zip", "DateTime": ""}  # lossless; no date
REMEDY = "copy or make it again (`dvc repro` or `dvc pull` for those of the pipeline)"

oiio.attribute("threads", 1)  # as everything else; and forked processes inherit no threads
oiio.attribute("exr_threads", -1)


@dataclass(frozen=True)
class Pixels:
    """What a file holds; `linear` where its values are light rather than sRGB."""

    values: NDArray[Any]  # [H,W,C], integers or floats as stored
    alpha: bool  # whether the last channel is opacity, which colours are not multiplied with
    linear: bool
    palette: bool  # whether the file stored indices of colours


def read_pixels(path: Path, size: tuple[int, int] | None = None) -> Pixels:
    """Decode a file.

    Args:
        path: of it; its content says what kind it is, whatever its name ends in.
        size: width and height that it must have; others are refused before they are decoded.

    Raises:
        ArtifactError: if it is missing, damaged, too large or no picture, or its name no UTF-8.
    """
    with _opened(path) as (file, spec):
        if size is not None and (spec.width, spec.height) != size:
            raise ArtifactError(
                f"{path} is {spec.width} x {spec.height}, wanted {size[0]} x {size[1]}; {REMEDY}"
            )
        values = file.read_image(0, 0, 0, spec.nchannels, spec.format)
        error = file.geterror()
        # A JPEG that ends early is filled up with grey; other complaints are left to the decoder.
        if values is None or "Premature end" in error:
            raise damaged(path, error)
        orientation = spec.getattribute("Orientation")
        space = spec.getattribute("oiio:ColorSpace") or spec.getattribute("tiff:ColorSpace") or ""
        return Pixels(
            values=_turned(values, orientation) if orientation in range(2, 9) else values,
            alpha=spec.nchannels > 1 and spec.channelnames[-1] == "A",
            linear=_is_linear(path, space, file.format_name()),
            palette=_has_palette(path, file.format_name(), spec),
        )


def read_attribute(path: Path, name: str) -> Any:
    """What a file says beside its pixels, by OpenImageIO's name; None if it does not.

    Raises:
        ArtifactError: if it is missing, damaged, too large or no picture, or its name no UTF-8.
    """
    with _opened(path) as (_, spec):
        return spec.getattribute(name)


def encoded(pixels: NDArray[Any], suffix: str, options: Mapping[str, object]) -> bytes:
    """The bytes of a file of [H,W,C] 8-bit values, or of light where it is `.exr`.

    Raises:
        OSError: if there is no place for it, or a file of this kind cannot hold them.
    """
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, "half" if suffix == ".exr" else "uint8")
    for name, value in options.items():
        spec[name] = value
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"picture{suffix}")
        file: Any = oiio.ImageOutput.create(str(path))
        done = (
            file.open(str(path), spec)
            and file.write_image(np.ascontiguousarray(pixels))
            and file.close()
        )
        if not done:
            raise OSError(
                f"cannot encode a {suffix} picture of shape {pixels.shape}: {file.geterror()}"
            )
        return _bare(path.read_bytes())


def palette_indices(path: Path) -> NDArray[np.uint8]:
    """The indices [H,W] of a sound file's palette; OpenImageIO knows only the colours."""
    with Image.open(path, formats=("PNG", "TIFF")) as image:
        return np.asarray(image)


def damaged(path: Path, reason: str) -> ArtifactError:
    """The error for a file that is no picture, with OpenImageIO's or another reason."""
    # The last line says what it came to; the path is in it once more.
    reason = (reason.strip().splitlines() or ["its content is damaged"])[-1]
    reason = reason.replace(f' ("{path}")', "")
    return ArtifactError(f"{path} is not a picture that can be read: {reason}; {REMEDY}")


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """A file and what it says of itself, which is of a size that may be decoded."""
    path = Path(path)
    try:
        with path.open("rb") as file:
            start = file.read(16)
    except OSError as error:
        raise ArtifactError(f"cannot read {path}: {error.strerror}") from None
    kind = next((kind for magic, kind in KINDS.items() if start.startswith(magic)), None)
    if kind is None:
        raise damaged(path, "of no known kind" if start else "an empty file")
    if str(path).encode(errors="replace").decode() != str(path):  # OpenImageIO takes text alone
        raise ArtifactError(f"the name {os.fsencode(path)!r} is not UTF-8; rename it")
    config = oiio.ImageSpec()
    config["oiio:UnassociatedAlpha"] = 1
    # The readers of other kinds do not get to see a file unless its name misleads.
    oiio.attribute("try_all_readers", int(not path.name.lower().endswith(ENDINGS[kind])))
    picture = None
    try:
        picture = oiio.ImageInput.open(str(path), config)
        if picture is None:
            raise damaged(path, oiio.geterror())
        if picture.format_name() != kind:
            raise damaged(path, f"it begins as {kind} but is none")
        spec = picture.spec()
        if spec.width * spec.height > MAX_PIXELS:
            raise ArtifactError(
                f"{path} unfolds to {spec.width} x {spec.height} pixels, at most "
                f"{MAX_PIXELS // 10**6} million are read; scale it down"
            )
        if spec.depth != 1 or spec.deep or not 1 <= spec.nchannels <= MAX_CHANNELS:
            raise damaged(path, f"it has channels {spec.channelnames}, wanted grey or RGB")
        yield picture, spec
    except ArtifactError:
        raise
    except Exception as error:
        # Names and messages need not be text, and what is left may raise nearly anything.
        raise damaged(path, f"{error}") from error
    finally:
        if picture is not None:
            picture.close()


ENDINGS = {
    "png": (".png",), "jpeg": (".jpg", ".jpeg"), "tiff": (".tif", ".tiff"), "bmp": (".bmp",),
    "webp": (".webp",), "pnm": (".ppm", ".pgm", ".pbm", ".pnm"), "openexr": (".exr",),
}  # fmt: skip


def _turned(values: NDArray[Any], orientation: int) -> NDArray[Any]:
    buffer = oiio.ImageBuf(values)
    buffer.specmod()["Orientation"] = orientation
    pixels: Any = oiio.ImageBufAlgo.reorient(buffer).get_pixels(buffer.spec().format)
    return pixels


def _is_linear(path: Path, space: str, kind: str) -> bool:
    """Whether values are light; refuses spaces that are neither sRGB nor its light."""
    if space.endswith("LAB"):
        raise damaged(path, f"its colours are in {space}, wanted grey, RGB or CMYK")
    if space.startswith("lin_") and "rec709" not in space and "srgb" not in space:
        raise damaged(path, f"its colours are in {space}, wanted linear light in Rec. 709")
    return space.startswith("lin_") or kind == "openexr"


def _has_palette(path: Path, kind: str, spec: Any) -> bool:
    if kind == "png":
        with path.open("rb") as file:
            return file.read(26)[25:] == b"\x03"  # the header's colour type
    return spec.getattribute("tiff:ColorSpace") == "palette"


def _bare(content: bytes) -> bytes:
    """A PNG file with its critical chunks alone; a JPEG file without its block of EXIF."""
    if content.startswith(b"\x89PNG"):
        kept, at = [content[:8]], 8
        while at < len(content):
            end = at + 12 + int.from_bytes(content[at : at + 4], "big")
            if content[at + 4 : at + 5].isupper():  # critical, by the format's definition
                kept.append(content[at:end])
            at = end
        return b"".join(kept)
    if content.startswith(b"\xff\xd8"):
        at = content.index(b"\xff\xe1")
        return content[:at] + content[at + 2 + int.from_bytes(content[at + 2 : at + 4], "big") :]
    return content
