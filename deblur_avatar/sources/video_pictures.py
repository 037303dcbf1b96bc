"""Frames of a container as upright pictures of square pixels in sRGB.

Conventions. A stream may store half pictures of two instants in one frame (interlacing), pixels
that are wider than high, and light beyond what sRGB holds (HLG and PQ, which phones film in).
"""

import logging
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import cache
from typing import cast

import av
import cv2
import numpy as np
import torch
from av.sidedata.sidedata import SideData
from av.video.reformatter import ColorPrimaries, ColorTrc
from jaxtyping import Float, UInt8, UInt16

from deblur_avatar.imaging.color import linear_to_srgb

logger = logging.getLogger(__name__)

HDR = {int(ColorTrc.ARIB_STD_B67): "HLG", int(ColorTrc.SMPTE2084): "PQ"}
WHITE_HLG = 0.75  # signal of a white sheet of paper, BT.2408
WHITE_PQ = 203.0  # its light, cd/m2
LEVELS = 1 << 16
BT2020_TO_BT709 = np.array(
    [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]],
    np.float32,
)  # of linear light


def decoded(
    container: av.container.InputContainer, stream: av.VideoStream, name: str
) -> Iterator[tuple[av.VideoFrame, UInt8[np.ndarray, "H W 3"]]]:
    """Each frame and its picture, upright; what had to be done to it is said once.

    Args:
        container: open file.
        stream: of it.
        name: what messages call it.
    """
    told: set[str] = set()
    held: tuple[float, ...] | None = None  # of the first frame: side data keep frames in memory

    def tell(what: str) -> None:
        if what not in told:
            told.add(what)
            logger.warning("%s: %s", name, what)

    for frame in _whole_frames(container, stream, tell):
        transfer = HDR.get(int(frame.color_trc))
        if transfer is None:
            image = frame.to_ndarray(format="rgb24")
        else:
            tell(f"light beyond white ({transfer}) is brought to sRGB; highlights are cut off")
            wide = int(frame.color_primaries) == int(ColorPrimaries.BT2020)
            image = srgb_of_hdr(frame.to_ndarray(format="rgb48le"), transfer, wide)
        shape = stream.sample_aspect_ratio or Fraction(1)
        if shape != 1:
            tell(f"pixels of {shape.numerator}:{shape.denominator} are made square")
            width = max(1, round(image.shape[1] * shape))
            image = _stretched(image, width)
        held = _display_matrix(frame) if held is None else held
        yield frame, _upright(image, held)


def _whole_frames(
    container: av.container.InputContainer, stream: av.VideoStream, tell: Callable[[str], None]
) -> Iterator[av.VideoFrame]:
    """Frames as they are, or of interlaced ones the first field, its missing rows filled in."""
    frames = container.decode(stream)
    first = next(frames, None)
    if first is None:
        return
    if not first.interlaced_frame:
        yield first
        yield from frames
        return
    tell("frames are interlaced, two instants in one; the first is kept, its rows filled (bwdif)")
    graph = av.filter.Graph()
    graph.link_nodes(
        graph.add_buffer(template=stream),
        graph.add("bwdif", "mode=send_frame:deint=interlaced"),
        graph.add("buffersink"),
    ).configure()
    yield from _filtered(graph, first)
    for frame in frames:
        yield from _filtered(graph, frame)
    yield from _filtered(graph, None)


def _filtered(graph: av.filter.Graph, frame: av.VideoFrame | None) -> Iterator[av.VideoFrame]:
    graph.vpush(frame)
    while True:
        try:
            yield graph.vpull()
        except (av.error.BlockingIOError, av.error.EOFError):
            return


def _display_matrix(frame: av.VideoFrame) -> tuple[float, ...]:
    """How a picture is to be turned and mirrored: a, b, c and d of x' = a x + c y, y' = b x + d y.

    Source: ISO/IEC 14496-12, 8.3.2.
    """
    found = cast(SideData | None, frame.side_data.get("DISPLAYMATRIX"))
    if found is None:
        return 1.0, 0.0, 0.0, 1.0
    matrix = np.frombuffer(bytes(found), np.int32)
    return tuple(matrix[[0, 1, 3, 4]].astype(float).tolist())


def _upright(
    image: UInt8[np.ndarray, "H W 3"], matrix: tuple[float, ...]
) -> UInt8[np.ndarray, "h w 3"]:
    """The picture as its display matrix asks for, by quarters of a turn."""
    a, b, c, d = matrix
    if abs(b) > abs(a):
        image, right, down = image.transpose(1, 0, 2), c, b
    else:
        right, down = a, d
    return np.ascontiguousarray(image[:: -1 if down < 0 else 1, :: -1 if right < 0 else 1])


def _stretched(image: UInt8[np.ndarray, "H W 3"], width: int) -> UInt8[np.ndarray, "H w 3"]:
    size = (width, image.shape[0])
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def srgb_of_hdr(
    signal: UInt16[np.ndarray, "H W 3"], transfer: str, wide: bool
) -> UInt8[np.ndarray, "H W 3"]:
    """High dynamic range as sRGB: scene light of HLG, display light of PQ (BT.2100), white at 1.

    Args:
        signal: full range.
        transfer: "HLG" or "PQ".
        wide: primaries are BT.2020's; else they are sRGB's.

    Returns:
        What is brighter than white, or more colourful than sRGB can be, is cut off.
    """
    light = _light(transfer)[signal]
    if wide:
        light = cv2.transform(light, BT2020_TO_BT709)
    return _srgb()[(light.clip(0, 1) * (LEVELS - 1) + 0.5).astype(np.uint16)]


@cache
def _light(transfer: str) -> Float[np.ndarray, " 65536"]:
    """Linear light of each signal, white at 1; BT.2100-2, tables 4 and 5."""
    signal = np.arange(LEVELS) / (LEVELS - 1)
    if transfer == "HLG":
        light, white = _scene_light(signal), _scene_light(np.array(WHITE_HLG))
        return (light / white).astype(np.float32)
    m1, m2 = 2610 / 16384, 2523 / 4096 * 128
    c1, c2, c3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
    root = signal ** (1 / m2)
    light = 10000 * ((root - c1).clip(0) / (c2 - c3 * root)) ** (1 / m1)
    return (light / WHITE_PQ).astype(np.float32)


def _scene_light(signal: Float[np.ndarray, " *n"]) -> Float[np.ndarray, " *n"]:
    """HLG's inverse OETF."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(signal <= 0.5, signal**2 / 3, (np.exp((signal - c) / a) + b) / 12)


@cache
def _srgb() -> UInt8[np.ndarray, " 65536"]:
    light = torch.arange(LEVELS, dtype=torch.float64) / (LEVELS - 1)
    return (linear_to_srgb(light) * 255).round().byte().numpy()
