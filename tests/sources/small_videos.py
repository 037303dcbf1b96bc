"""Videos of a few pixels, written as phones and editors write them."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np

WIDTH, HEIGHT, FPS = 48, 32, 25
TICKS = 1000  # a second


def picture(index: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """Left half red, the right half of a grey that counts frames."""
    image = np.full((height, width, 3), 20 * index + 20, np.uint8)
    image[:, : width // 2] = (200, 30, 30)
    return image


def write_video(
    path: Path,
    pictures: list[np.ndarray],
    seconds: list[float] | None = None,
    metadata: dict[str, str] | None = None,
) -> Path:
    """Encode without loss, each frame at its own time."""
    seconds = seconds or [index / FPS for index in range(len(pictures))]
    options = {"movflags": "use_metadata_tags"} if path.suffix == ".mp4" else {}
    with av.open(str(path), "w", options=options) as container:
        container.metadata.update(metadata or {})
        stream = container.add_stream("libx264rgb", rate=FPS, options={"crf": "0"})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = "rgb24"
        stream.time_base = stream.codec_context.time_base = Fraction(1, TICKS)
        stream.codec_context.max_b_frames = 0
        for image, time in zip(pictures, seconds, strict=True):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = round(time * TICKS), Fraction(1, TICKS)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def held_otherwise(
    path: Path, recording: Path, rotation: int, *, hflip: bool = False, vflip: bool = False
) -> Path:
    """The same encoded frames in a file that says how the camera was held, degrees."""
    with av.open(str(recording)) as read, av.open(str(path), "w") as container:
        stream = container.add_stream_from_template(read.streams.video[0])
        stream.set_display_rotation(rotation, hflip=hflip, vflip=vflip)
        for packet in read.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                container.mux(packet)
    return path
