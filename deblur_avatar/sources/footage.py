"""Footage of one camera: pictures and timestamps, from a video file or a folder.

Conventions. Frames are numbered from 0 as the file holds them (a folder: in the natural order of
its names). What is kept is one recording, the longest, and of it new frames only: one that repeats
its predecessor was put in by a player or an editor and was never taken. Gaps, where frames were
dropped, stay in the timestamps.
"""

import logging
import re
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64, UInt8
from torch import Tensor

from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.files import readable
from deblur_avatar.frame_numbers import spans
from deblur_avatar.imaging.picture_files import read_picture
from deblur_avatar.sources.fades import longest_without_fades
from deblur_avatar.sources.footage_damage import (
    conversion,
    evenly_respaced,
    light_drift,
    mostly_copied,
    repeated_frames,
)
from deblur_avatar.sources.shots import longest_shot, shot_starts
from deblur_avatar.sources.video_files import read_video, shrunk

logger = logging.getLogger(__name__)

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".exr")
GAP = 1.5  # frame intervals from which on a frame is missing
LOOKED_AT = 16  # rows of frames that are read only to see whether they can be
DRIFT = 0.2  # stops of light from which on a user is told


@dataclass(frozen=True)
class Footage:
    """Frames of one camera; `numbers` say which of the file's they are."""

    frames: UInt8[Tensor, "F H W 3"]
    timestamps: Float64[Tensor, " F"]  # seconds
    numbers: tuple[int, ...]
    total: int | None  # frames of the file, where it was read to its end
    recorded_size: tuple[int, int]  # width and height before scaling, pixels
    converted: bool = False  # copies raised the file's frame rate: `numbers` count them, too

    @property
    def interval(self) -> float:
        """Seconds from one recorded frame to the next, as a rule.

        Copies are read only where pictures are further apart than the frames that are read, so of
        converted footage every picture is here, whatever the stride.
        """
        steps = self.timestamps.diff()
        if not self.converted:
            steps = steps / torch.tensor(self.numbers).diff()
        return float(steps.median())


def read_footage(
    path: Path, frames: tuple[int, int | None], stride: int, fps: float, height: int
) -> Footage:
    """Read a video or a folder of pictures.

    Args:
        path: which.
        frames: first, and one past the last or None for all.
        stride: every n-th is read.
        fps: frames a second of a folder; a video knows its times.
        height: rows that larger frames are scaled down to.

    Raises:
        ConfigError: if there is no such file or folder, or fewer than two frames are asked for.
        ArtifactError: if it cannot be decoded, or holds too few frames, or pictures of two sizes.
    """
    first, stop = frames
    if stop is not None and stop - first <= stride:
        raise ConfigError(f"clip.frames: {first} to {stop} by {stride} are fewer than two frames")
    read = _as_it_is(path, first, stop, stride, fps, height)
    return _new_frames(_one_shot(_unfaded(read, path), path), path)


def check_readable(path: Path) -> None:
    """Read the first two frames of a video or a folder, whatever they show.

    Raises:
        ConfigError: if there is no such file or folder.
        ArtifactError: if it cannot be decoded, or holds too few frames.
    """
    _as_it_is(path, 0, 2, 1, 1.0, LOOKED_AT)


def _as_it_is(
    path: Path, first: int, stop: int | None, stride: int, fps: float, height: int
) -> Footage:
    with readable(path):
        a_folder, a_file = path.is_dir(), path.is_file()
    if a_folder:
        return _read_folder(path, first, stop, stride, fps, height)
    if not a_file:
        raise ConfigError(f"clip.path: no video and no folder {path}; name the footage to be read")
    video = read_video(path, first, stop, height, stride)
    numbers = tuple(range(first, first + stride * len(video.frames), stride))
    return Footage(video.frames, video.timestamps, numbers, video.total, video.recorded_size)


def files_in_order(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Files of these kinds, numbers in their names counted as numbers: `f2` before `f10`.

    Raises:
        ArtifactError: if the folder may not be read.
    """
    with readable(folder):
        found = [path for path in folder.iterdir() if path.suffix.lower() in suffixes]
        files = [path for path in found if path.is_file()]
    return sorted(files, key=lambda path: natural_order(path.name))


def natural_order(name: str) -> list[tuple[int, int, str]]:
    """What to sort names by, so that `f2` comes before `f10`."""
    pieces = re.split(r"(\d+)", name)
    return [(0, int(piece), "") if piece.isdecimal() else (1, 0, piece) for piece in pieces]


def _read_folder(
    folder: Path, first: int, stop: int | None, stride: int, fps: float, height: int
) -> Footage:
    files = files_in_order(folder, PICTURES)
    chosen = list(range(len(files)))[first:stop:stride]
    if not chosen or (stop is not None and stop > len(files)):
        held = "1 picture" if len(files) == 1 else f"{len(files)} pictures"
        wanted = f"wanted {first} to {stop or 'the last'}"
        raise ArtifactError(
            f"{folder} holds {held}, {'at least two are needed' if len(files) < 2 else wanted}; "
            f"pictures are {', '.join(PICTURES)}"
        )
    pictures, size = [], None
    for number in chosen:
        picture = read_picture(files[number])
        found = (picture.shape[1], picture.shape[0])
        size = size or found
        if found != size:
            raise ArtifactError(f"{files[number]} is {found}, the pictures before it {size}")
        pictures.append(torch.from_numpy(shrunk(picture, height)))
    return Footage(
        frames=torch.stack(pictures),
        timestamps=torch.tensor(chosen, dtype=torch.float64) / fps,
        numbers=tuple(chosen),
        total=len(files),
        recorded_size=size or (0, 0),
    )


def _unfaded(read: Footage, path: Path) -> Footage:
    """Leave out what fades in from one colour or out into it, and say so."""
    first, stop = longest_without_fades(read.frames)
    if stop - first == len(read.frames):
        return read
    logger.warning(
        "%s: fades in or out; taken are frames %d to %d",
        path, read.numbers[first], read.numbers[stop - 1],
    )  # fmt: skip
    return _part(read, first, stop)


def _one_shot(read: Footage, path: Path) -> Footage:
    """Keep the longest recording of edited footage, and say which one that is.

    Cuts are looked for between pictures, not their copies, beside which any step looks like one.
    """
    repeats = set(repeated_frames(read.frames))
    pictures = [index for index in range(len(read.frames)) if index not in repeats]
    cuts = {pictures[start] for start in shot_starts(read.frames[pictures])}
    starts = sorted(cuts | _clock_starts(read.timestamps))
    if len(starts) == 1:
        return read
    first, stop = longest_shot(starts, len(read.frames))
    logger.warning(
        "%s: %d shots, cut before frames %s; taken is the longest, frames %d to %d. Set "
        "clip.frames for another",
        path,
        len(starts),
        spans([read.numbers[index] for index in starts[1:]]),
        read.numbers[first],
        read.numbers[stop - 1],
    )
    return _part(read, first, stop)


def _clock_starts(timestamps: Float64[Tensor, " F"]) -> set[int]:
    """Frames before which time went back: files of a camera that were joined as they are."""
    steps = timestamps.diff()
    back = steps < -GAP * steps.abs().median()
    return {1 + int(index) for index in torch.nonzero(back).flatten()}


def _part(read: Footage, first: int, stop: int) -> Footage:
    return replace(
        read,
        frames=read.frames[first:stop],
        timestamps=read.timestamps[first:stop],
        numbers=read.numbers[first:stop],
    )


def _new_frames(read: Footage, path: Path) -> Footage:
    """Leave out repeated frames and those whose time does not advance; tell of gaps and drifts."""
    repeats = repeated_frames(read.frames)
    new = [0]
    for index in range(1, len(read.frames)):
        later = bool(read.timestamps[index] > read.timestamps[new[-1]])
        if later and index not in repeats:
            new.append(index)
    if len(new) < 2:
        raise ArtifactError(f"{path} shows {len(new)} picture; a clip is two or more")
    if len(new) < len(read.frames):
        left_out = [read.numbers[i] for i in range(len(read.frames)) if i not in set(new)]
        logger.warning("%s: %d repeated frames left out: %s", path, len(left_out), spans(left_out))
    pictures = conversion(repeats, len(read.frames))
    if len(new) + len(repeats) != len(read.frames):
        pictures = None
    kept = Footage(
        frames=read.frames[new],
        timestamps=_times_of_new(read, new, pictures, path),
        numbers=tuple(read.numbers[index] for index in new),
        total=read.total,
        recorded_size=read.recorded_size,
        converted=pictures is not None or mostly_copied(new),
    )
    _tell_of_gaps(kept, path)
    _tell_of_drift(kept, path)
    return kept


def _times_of_new(
    read: Footage, new: list[int], pictures: Fraction | None, path: Path
) -> Float64[Tensor, " F"]:
    """Times as the container says, or as they were before a conversion put frames in."""
    if pictures is None:
        return read.timestamps[new]
    copies, period = pictures.denominator - pictures.numerator, pictures.denominator
    logger.warning(
        "%s: %s the one before, so its frame rate was converted; the others are taken to be evenly "
        "spaced",
        path,
        f"every {period}. frame repeats" if copies == 1 else f"{copies} of {period} frames repeat",
    )
    return evenly_respaced(read.timestamps, new, pictures)


def _tell_of_gaps(kept: Footage, path: Path) -> None:
    steps = kept.timestamps.diff()
    gaps = np.flatnonzero((steps > GAP * steps.median()).numpy())
    if len(gaps):
        before = spans([kept.numbers[index] for index in gaps])
        logger.warning("%s: %d gaps in time, after frames %s", path, len(gaps), before)


def _tell_of_drift(kept: Footage, path: Path) -> None:
    stops = light_drift(kept.frames)
    if stops.max() > DRIFT:
        logger.warning(
            "%s: the camera's exposure or white balance drifts by %.2f, %.2f and %.2f stops (red, "
            "green, blue); lock them when filming, or set avatars.<name>.exposure_gain: frame",
            path,
            *stops,
        )
