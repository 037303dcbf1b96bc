"""Frame interpolation: what a camera would have seen between two frames.

Conventions. `u` in (0, 1) is time from frame `a` to frame `b`, an exact fraction. Images are uint8
with sRGB in their first three channels; further ones (a matte) are carried along. Flows are in
pixels, (x, y): `a_to_b[y, x]` is how far the surface at pixel (x, y) of `a` moves until `b`.

Source: Baker et al., "A Database and Evaluation Methodology for Optical Flow", IJCV 2011, section
3.3 (flow is cast forward to time u, then both frames are looked up backward). Flow: Kroeger et al.,
"Fast Optical Flow using Dense Inverse Search", ECCV 2016, as in OpenCV. The blend is ours: a frame
is believed at a pixel as far as its own flow agrees with the motion assumed there, which leaves out
the frame in which that surface is hidden.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

STILL = 1.0  # pixels a frame; less is not worth warping
AGREEMENT = 1.0  # pixels by which two motions differ when one of them is believed 1/e as much
DOUBT = 0.1  # belief that is left to a frame whose flow says otherwise
MINIMUM_COVER = 0.1  # pixels' worth of cast motion below which a pixel counts as still
SMALL_PICTURE = 512 * 512  # pixels; below, the flow's finest level is worth its time (0.4 dB)
SMALLEST_SIDE = 64  # pixels; less has no room for the flow's pyramid and is padded
MARGIN = 4  # pixels around what moves


@dataclass(frozen=True)
class Flow:
    """How the picture moves between two frames, both ways, and how far each way is trusted."""

    a_to_b: Float32[np.ndarray, "H W 2"]
    b_to_a: Float32[np.ndarray, "H W 2"]
    trust_a: Float32[np.ndarray, "H W"]  # (0, 1]: there and back leads home
    trust_b: Float32[np.ndarray, "H W"]
    box: tuple[slice, slice]  # rows, columns outside of which nothing moves


def estimate_flow(a: UInt8[np.ndarray, "H W D"], b: UInt8[np.ndarray, "H W D"]) -> Flow:
    """Match two frames by their brightness, in both directions."""
    grey_a, grey_b = _grey(a), _grey(b)
    return compare_flows(_search(grey_a, grey_b), _search(grey_b, grey_a))


def compare_flows(
    a_to_b: Float32[np.ndarray, "H W 2"], b_to_a: Float32[np.ndarray, "H W 2"]
) -> Flow:
    """Trust each way as far as going there and back leads home."""
    trust_a = _belief(_look_up(b_to_a, a_to_b) + a_to_b)
    trust_b = _belief(_look_up(a_to_b, b_to_a) + b_to_a)
    reach = np.sqrt(np.maximum(_squared(a_to_b), _squared(b_to_a)))
    return Flow(a_to_b, b_to_a, trust_a, trust_b, _box(reach))


def interpolate(
    a: UInt8[np.ndarray, "H W D"], b: UInt8[np.ndarray, "H W D"], flow: Flow, u: Fraction
) -> UInt8[np.ndarray, "H W D"]:
    """Draw the picture at time `u` between two frames; 0 and 1 give the frames themselves.

    Raises:
        ValueError: if `u` is not in [0, 1].
    """
    if not 0 <= u <= 1:
        raise ValueError(f"u must be in [0, 1], got {u}")
    if u in (0, 1):
        return b if u else a
    time = float(u)
    image = cv2.addWeighted(a, 1 - time, b, time, 0)
    if flow.box[0].stop > flow.box[0].start:
        image[flow.box] = _draw(a[flow.box], b[flow.box], _crop(flow), time)
    return image


def subframes(
    frames: Iterable[UInt8[np.ndarray, "H W D"]], factor: int
) -> Iterator[UInt8[np.ndarray, "H W D"]]:
    """Raise the frame rate: all frames, unchanged, with `factor - 1` pictures between each two.

    Two frames and their flow are in memory at a time.
    """
    before: UInt8[np.ndarray, "H W D"] | None = None
    for frame in frames:
        if before is not None and factor > 1:
            flow = estimate_flow(before, frame)
            for step in range(1, factor):
                yield interpolate(before, frame, flow, Fraction(step, factor))
        yield frame
        before = frame


def _grey(image: UInt8[np.ndarray, "H W D"]) -> UInt8[np.ndarray, "H W"]:
    return cv2.cvtColor(np.ascontiguousarray(image[..., :3]), cv2.COLOR_RGB2GRAY)


def _search(
    a: UInt8[np.ndarray, "H W"], b: UInt8[np.ndarray, "H W"]
) -> Float32[np.ndarray, "H W 2"]:
    height, width = a.shape
    below, right = max(0, SMALLEST_SIDE - height), max(0, SMALLEST_SIDE - width)
    if below or right:
        a, b = (cv2.copyMakeBorder(x, 0, below, 0, right, cv2.BORDER_REPLICATE) for x in (a, b))
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    if height * width < SMALL_PICTURE:
        search.setFinestScale(0)
    # OpenCV's stubs forget that there may be no first guess.
    return search.calc(a, b, None)[:height, :width]  # type: ignore[call-overload]


def _belief(difference: Float32[np.ndarray, "H W 2"]) -> Float32[np.ndarray, "H W"]:
    return cv2.exp(_squared(difference) * (-1 / AGREEMENT**2)) + np.float32(DOUBT)


def _squared(vectors: Float32[np.ndarray, "H W 2"]) -> Float32[np.ndarray, "H W"]:
    return vectors[..., 0] ** 2 + vectors[..., 1] ** 2


def _look_up(
    image: np.ndarray, offset: Float32[np.ndarray, "H W 2"], scale: float = 1.0
) -> np.ndarray:
    height, width = offset.shape[:2]
    x = offset[..., 0] * scale + np.arange(width, dtype=np.float32)
    y = offset[..., 1] * scale + np.arange(height, dtype=np.float32)[:, None]
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _box(reach: Float32[np.ndarray, "H W"]) -> tuple[slice, slice]:
    moves = reach > STILL
    if not moves.any():
        return slice(0, 0), slice(0, 0)
    margin = MARGIN + int(reach.max())
    return _span(moves.max(1), margin), _span(moves.max(0), margin)


def _span(moves: Bool[np.ndarray, " L"], margin: int) -> slice:
    where = np.flatnonzero(moves)
    return slice(max(0, int(where[0]) - margin), min(len(moves), int(where[-1]) + margin + 1))


def _crop(flow: Flow) -> Flow:
    box = flow.box
    return Flow(flow.a_to_b[box], flow.b_to_a[box], flow.trust_a[box], flow.trust_b[box], box)


def _draw(
    a: UInt8[np.ndarray, "H W D"], b: UInt8[np.ndarray, "H W D"], flow: Flow, u: float
) -> UInt8[np.ndarray, "H W D"]:
    motion = _motion_at(flow, u)
    believed_a = (1 - u) * _belief(_look_up(flow.a_to_b, motion, -u) - motion)
    believed_b = u * _belief(_look_up(flow.b_to_a, motion, 1 - u) + motion)
    share = (believed_b / (believed_a + believed_b))[..., None]
    from_a = _look_up(a, motion, -u).reshape(a.shape).astype(np.float32)
    from_b = _look_up(b, motion, 1 - u).reshape(b.shape)
    return np.rint(from_a + share * (from_b - from_a)).astype(np.uint8)


def _motion_at(flow: Flow, u: float) -> Float32[np.ndarray, "H W 2"]:
    """Motion from a to b of the surface at each pixel of time u; 0 where nothing moves to."""
    height, width = flow.trust_a.shape
    arrived = _cast(flow.a_to_b, flow.trust_a * np.float32(1 - u), u)
    came_back = _cast(flow.b_to_a, flow.trust_b * np.float32(u), 1 - u)
    cover = np.maximum(arrived[2] + came_back[2], MINIMUM_COVER)
    motion = (arrived[:2] - came_back[:2]) / cover
    return np.ascontiguousarray(motion.T.reshape(height, width, 2), np.float32)


def _cast(
    flow: Float32[np.ndarray, "H W 2"], weight: Float32[np.ndarray, "H W"], duration: float
) -> Float64[np.ndarray, "3 P"]:
    """Carry each moving pixel along its flow for a share of it, to P = H W pixels.

    Returns:
        Where it arrives: the sums of weighted flow (x, y), and of weights, split over the four
        pixels around.
    """
    height, width = weight.shape
    sums = np.zeros((3, height * width))
    rows, columns = (_squared(flow) > STILL**2).nonzero()
    step, weight = flow[rows, columns], weight[rows, columns]
    x, y = columns + duration * step[:, 0], rows + duration * step[:, 1]
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    for down in (0, 1):
        for right in (0, 1):
            column, row = left + right, top + down
            share = (1 - np.abs(x - column)) * (1 - np.abs(y - row)) * weight
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            index, share, part = (row * width + column)[inside], share[inside], step[inside]
            for total, value in zip(sums, (part[:, 0], part[:, 1], 1), strict=True):
                total += np.bincount(index, share * value, len(total))
    return sums
