"""Video encoding: H.264 in an mp4 file that plays everywhere.

One encoder thread, no clock and no B pictures (with some of them as references x264 writes other
bytes now and then), so equal pictures give equal bytes with one version of the encoder, but where a
processor with AVX-512 is shared: one file of ten noisy frames in 500 to 1,600 is another there,
which `X264_VARIABLE` prevents (docs/decisions/0078-an-encoder-that-errs.md).
"""

import logging
import os
from collections.abc import Iterable
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.video.reformatter import ColorRange, Colorspace
from jaxtyping import UInt8

from deblur_avatar.errors import ArtifactError

logger = logging.getLogger(__name__)

# Further parameters of x264, spelt as its own program spells them. `asm=avx2`, say, holds it back
# to the instructions of an older processor, with which it writes other bytes.
X264_VARIABLE = "DEBLUR_AVATAR_X264"

QUALITY = 18  # x264's constant rate factor: differences are hard to see
BT709 = 1  # ITU-T H.273's number for HD television's primaries and matrix
SRGB_CURVE = 13  # ITU-T H.273's number for sRGB's curve


def write_video(
    path: Path,
    pictures: Iterable[UInt8[np.ndarray, "H W 3"]],
    fps: float,
    quality: int = QUALITY,
) -> int:
    """Encode pictures in order, replacing `path` in one move: whole or not at all.

    Odd widths and heights, which the format cannot hold, get a column or row more (the last one
    again).

    Args:
        path: ends in `.mp4`.
        pictures: sRGB, all of one size.
        fps: pictures a second.
        quality: x264's constant rate factor, from 0 (best) to 51.

    Returns:
        How many pictures were written.

    Raises:
        ValueError: for no picture at all, or pictures of different sizes.
        ArtifactError: if the disk refuses.
    """
    path = Path(path)
    scratch = path.with_name(f".{path.stem}.part.mp4")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        count = _encode(scratch, pictures, fps, quality)
        scratch.replace(path)
    except OSError as error:
        raise ArtifactError(f"cannot write video {path}: {error}") from error
    finally:
        with suppress(OSError):
            scratch.unlink()
    return count


def _encode(
    path: Path, pictures: Iterable[UInt8[np.ndarray, "H W 3"]], fps: float, quality: int
) -> int:
    options = {"movflags": "+faststart", "fflags": "+bitexact"}
    with av.open(str(path), "w", format="mp4", options=options) as container:
        stream = None
        count = 0
        for count, picture in enumerate(pictures, start=1):
            even = np.pad(picture, [(0, n % 2) for n in picture.shape[:2]] + [(0, 0)], mode="edge")
            if stream is None:
                stream = _open_stream(container, even, fps, quality)
            if even.shape[:2] != (stream.height, stream.width):
                raise ValueError(
                    f"picture {count} is {even.shape[1]} x {even.shape[0]} pixels, those before "
                    f"are {stream.width} x {stream.height}"
                )
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
            frame = frame.reformat(
                format="yuv420p",
                dst_colorspace=Colorspace.ITU709,
                dst_color_range=ColorRange.MPEG,
            )
            container.mux(stream.encode(frame))
        if stream is None:
            raise ValueError("a video needs at least one picture")
        container.mux(stream.encode())
    return count


def _open_stream(
    container: av.container.OutputContainer,
    picture: UInt8[np.ndarray, "H W 3"],
    fps: float,
    quality: int,
) -> av.VideoStream:
    stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
    stream.height, stream.width = picture.shape[:2]
    stream.pix_fmt = "yuv420p"
    options: dict[str, object] = {"crf": str(quality), "threads": "1", "bf": "0"}
    options["flags"] = "+bitexact"
    if further := os.environ.get(X264_VARIABLE):
        options["x264-params"] = further
    stream.options = options
    context = stream.codec_context
    context.color_primaries = context.colorspace = BT709
    context.color_trc = SRGB_CURVE
    context.color_range = ColorRange.MPEG
    return stream
