"""Video decoding: a file as frames and timestamps.

Conventions. Frames are upright (the container's rotation is applied) 8-bit sRGB of square pixels;
timestamps are the container's, in seconds.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np
import torch
from av.error import FFmpegError
from jaxtyping import Float64, UInt8
from torch import Tensor

from deblur_avatar.errors import ArtifactError
from deblur_avatar.files import readable
from deblur_avatar.readers.picture_codec import MAX_PIXELS
from deblur_avatar.sources.video_pictures import decoded

NO_OTHER_FILES = {"protocol_whitelist": "none"}


@dataclass(frozen=True)
class Video:
    """Some frames of a file."""

    frames: UInt8[Tensor, "F H W 3"]
    timestamps: Float64[Tensor, " F"]  # seconds
    recorded_size: tuple[int, int]  # width and height before scaling, pixels
    total: int | None  # frames of the file, where it was read to its end


def read_video(path: Path, first: int, stop: int | None, height: int, stride: int = 1) -> Video:
    """Read frames `first` to `stop` - 1 and scale them down to `height` rows as they come.

    Args:
        path: anything FFmpeg decodes.
        first: number of the first frame wanted, from 0.
        stop: one past the last; None for all there are.
        height: rows wanted; frames that have no more are kept as they are.
        stride: every n-th frame is kept.

    Raises:
        ArtifactError: if the file is missing, cannot be decoded, ends too early, or changes size.
    """
    frames: list[np.ndarray] = []
    timestamps: list[float] = []
    size: tuple[int, int] | None = None
    count = 0
    for image, seconds in _decode(path):
        found = (image.shape[1], image.shape[0])
        size = size or found
        if found != size:
            raise ArtifactError(f"{path}: frame {count} is {found}, those before it {size}")
        if count >= first and (count - first) % stride == 0:
            frames.append(shrunk(image, height))
            timestamps.append(seconds)
        count += 1
        if count == stop:
            break
    if not frames or size is None or (stop is not None and count < stop):
        if count == 1:
            raise ArtifactError(f"{path} holds 1 frame, at least two are needed; film longer")
        last = "the last" if stop is None else stop - 1
        raise ArtifactError(
            f"{path} ends after {count} frames, wanted frames {first} to {last}; download it "
            "again or ask for fewer frames"
        )
    return Video(
        frames=torch.from_numpy(np.stack(frames)),
        timestamps=torch.tensor(timestamps, dtype=torch.float64),
        recorded_size=size,
        total=None if count == stop else count,
    )


def container_metadata(path: Path) -> dict[str, str]:
    """What the container says of itself and of its video, as text."""
    with _opened(path) as container:
        return {**container.metadata, **container.streams.video[0].metadata}


def _decode(path: Path) -> Iterator[tuple[UInt8[np.ndarray, "H W 3"], float]]:
    """Decode upright frames and their times."""
    with readable(path):
        there = Path(path).is_file()
    if not there:
        raise ArtifactError(f"no video {path}; check the scene's root and videos")
    try:
        with _opened(path) as container:
            stream = container.streams.video[0]
            if stream.codec_context is None:
                raise ArtifactError(
                    f"{path} is in a format that is not known; convert it to H.264 in an mp4 file"
                )
            stream.thread_type = "AUTO"
            stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
            for index, (frame, image) in enumerate(decoded(container, stream, str(path))):
                seconds = frame.time
                if seconds is None:
                    seconds = index / float(stream.average_rate or 1)
                yield image, seconds
    except (FFmpegError, OSError, ValueError) as error:
        if isinstance(error, ArtifactError):
            raise
        raise ArtifactError(f"{path} cannot be decoded: {error}; download it again") from error


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[av.container.InputContainer]:
    """A file with a video in it that names no other file: playlists could read anything."""
    with readable(path):
        file = Path(path).open("rb")  # noqa: SIM115
    try:
        with (
            file,
            av.open(file, "r", options=NO_OTHER_FILES, metadata_errors="replace") as opened,
        ):
            if not opened.streams.video:
                raise ArtifactError(f"{path} holds no video")
            yield opened
    except (FFmpegError, OSError) as error:
        raise ArtifactError(f"{path} cannot be decoded: {error}; download it again") from error


def shrunk(image: UInt8[np.ndarray, "H W *c"], height: int) -> UInt8[np.ndarray, "h w *c"]:
    """Scale a picture down to `height` rows; one that has no more is kept as it is."""
    if image.shape[0] <= height:
        return image
    width = max(1, round(image.shape[1] * height / image.shape[0]))
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
