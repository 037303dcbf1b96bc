"""Multi-view source: a real person filmed by several calibrated video cameras.

Frame f of the clip is frame `frames[0] + f + frame_offsets[c]` of camera c's file. Pictures keep
their pixels: all are scaled down by one factor, then padded on the right and below to a common
size, which leaves intrinsics right.
"""

import logging
from pathlib import Path
from typing import Annotated, Literal

import torch
from jaxtyping import UInt8
from pydantic import Field
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.config.reading import missing_file
from deblur_avatar.config.section import (
    Count,
    Fraction,
    Params,
)
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.imaging.matting import (
    background_plate,
    lift_person,
    trim_mattes,
)
from deblur_avatar.imaging.resampling import undistort
from deblur_avatar.sources.calibration import read_calibration
from deblur_avatar.sources.folders import footage_folder
from deblur_avatar.sources.source import Segment
from deblur_avatar.sources.video_files import Video, read_video


class MultiviewParams(Params):
    """Video files of several calibrated cameras.

    `root` may hold `$(VARIABLE:-default)`. `frame_offsets` are added to each camera's frame
    numbers. Of all cameras but the training camera and the `pose_cameras`, sharp test views alone
    leave the source: no pixel of a camera that is scored enters poses, colours or training.
    """

    source: Literal["multiview"]
    root: str
    videos: tuple[str, ...]
    calibration: str
    frame_offsets: tuple[int, ...]
    principal_point_shifts: tuple[tuple[float, float], ...]  # added, pixels of the video
    frames: tuple[int, int]  # first, one past last
    image_height: Count  # frames are scaled to this height
    train_camera: Annotated[int, Field(ge=0)]
    pose_cameras: tuple[Annotated[int, Field(ge=0)], ...]  # recorded too, for estimated poses
    test_stride: Count
    held_out: Fraction

    def load(
        self, body: Body, segment: Segment, generator: torch.Generator
    ) -> tuple[Clip, Reference]:
        """Read all cameras' videos; the poses of a body are not among them."""
        return load_multiview(self, segment)

    def missing_files(self, where: str) -> tuple[str, ...]:
        """The videos' folder, where it is not here."""
        return missing_file(self.root, f"{where}.root", "folder", folder=True)


logger = logging.getLogger(__name__)

SAME_SIZE = 0.02  # share by which a video may differ from its calibration (1080 against 1088)

REMEDY = (
    "the videos are (for the default: Demo_SinglePerson of github.com/perfanalytics/pose2sim). The "
    "studio scene needs none"
)


def load_multiview(params: MultiviewParams, segment: Segment) -> tuple[Clip, Reference]:
    """Read all cameras' sharp frames, and cut the sharp test views out of those not trained on.

    Args:
        params: of the scene.
        segment: mattes of the test views are estimated with it, on the sharp frames.

    Raises:
        ConfigError: if the root is missing or the parameters contradict each other.
        ArtifactError: if a file is missing, damaged, or does not fit its calibration.
    """
    root = footage_folder(params.root, REMEDY)
    _check(params)
    cameras = read_calibration(root / params.calibration, len(params.videos))
    first, stop = params.frames
    rows = int(cameras.sizes[:, 1].max())
    videos = []
    for index, (name, offset) in enumerate(zip(params.videos, params.frame_offsets, strict=True)):
        height = round(int(cameras.sizes[index, 1]) * min(1.0, params.image_height / rows))
        video = read_video(root / name, first + offset, stop + offset, height)
        _check_size(video, cameras, index, root / name)
        videos.append(video)
    cameras = _scaled(cameras, videos, params.principal_point_shifts)
    recorded = (params.train_camera, *params.pose_cameras)
    frames = _padded(videos)
    count = stop - first
    clip = Clip(
        frames=frames[list(recorded)],
        mattes=None,
        recorded=recorded,
        train_camera=params.train_camera,
        cameras=cameras,
        timestamps=videos[params.train_camera].timestamps.float(),
        blurred=False,
        exposure=None,
        averaging_space="linear",
        held_out_from=max(1, round(count * (1 - params.held_out))),
        initial=None,
        exact=None,
        true_blur_srgb=None,
        true_blur_linear=None,
        true_blur_mattes=None,
        frame_indices=None,
        true_blur_exposure=None,
    )
    tested = {camera: frames[camera] for camera in range(len(videos)) if camera not in recorded}
    return clip, _reference(clip, tested, params.test_stride, segment)


def _check(params: MultiviewParams) -> None:
    count = len(params.videos)
    for key in ("frame_offsets", "principal_point_shifts"):
        if len(getattr(params, key)) != count:
            raise ConfigError(f"clip.{key} must have one entry for each of {count} videos")
    if params.train_camera >= count:
        raise ConfigError(f"clip.train_camera: {params.train_camera} of {count}, counted from 0")
    for camera in params.pose_cameras:
        if camera >= count:
            raise ConfigError(f"clip.pose_cameras: {camera} of {count}, counted from 0")
    used = {params.train_camera, *params.pose_cameras}
    if len(used) <= len(params.pose_cameras):
        raise ConfigError(
            f"clip.pose_cameras: {params.pose_cameras} name a camera twice, or the training camera "
            f"{params.train_camera}, which is recorded anyway"
        )
    if len(used) == count:
        raise ConfigError(
            "clip.videos: test views need a camera beside the training camera and clip.pose_cameras"
        )
    first, stop = params.frames
    if first + min(params.frame_offsets) < 0 or stop - first < 2:
        raise ConfigError(f"clip.frames: {first} to {stop} leave the videos or are under two")


def _check_size(video: Video, cameras: Cameras, index: int, path: Path) -> None:
    wanted = cameras.sizes[index].tolist()
    pairs = zip(video.recorded_size, wanted, strict=True)
    if any(abs(found - size) > SAME_SIZE * size for found, size in pairs):
        raise ArtifactError(
            f"{path}: frames are {video.recorded_size}, camera {cameras.names[index]} is "
            f"calibrated for {tuple(wanted)}; use the calibration of these videos"
        )


def _scaled(
    cameras: Cameras, videos: list[Video], shifts: tuple[tuple[float, float], ...]
) -> Cameras:
    """Cameras that see the pictures as read, with their principal points corrected."""
    Ks = cameras.Ks.clone()
    Ks[:, :2, 2] += torch.tensor(shifts)
    for K, video in zip(Ks, videos, strict=True):
        height, width = video.frames.shape[1:3]
        K[0] *= width / video.recorded_size[0]
        K[1] *= height / video.recorded_size[1]
    size = _common_size(videos)
    return Cameras(
        Ks=Ks,
        viewmats=cameras.viewmats,
        distortion=cameras.distortion,
        sizes=torch.tensor([size] * len(videos)),
        names=cameras.names,
    )


def _common_size(videos: list[Video]) -> tuple[int, int]:
    sizes = [video.frames.shape[1:3] for video in videos]
    return max(width for _, width in sizes), max(height for height, _ in sizes)


def _padded(videos: list[Video]) -> UInt8[Tensor, "R F H W 3"]:
    width, height = _common_size(videos)
    count = len(videos[0].frames)
    frames = torch.zeros(len(videos), count, height, width, 3, dtype=torch.uint8)
    for row, video in zip(frames, videos, strict=True):
        row[:, : video.frames.shape[1], : video.frames.shape[2]] = video.frames
    return frames


def _reference(
    clip: Clip, tested: dict[int, UInt8[Tensor, "F H W 3"]], stride: int, segment: Segment
) -> Reference:
    """Straight sharp views of the cameras that are not recorded, the person on black."""
    count = len(clip.timestamps)
    chosen = torch.arange(stride // 2, count, stride)
    images, mattes, cameras = [], [], []
    for camera, filmed in tested.items():
        lens = clip.cameras.Ks[camera], clip.cameras.distortion[camera]
        frames = undistort(filmed, *lens)
        found = segment(frames)
        plates = [background_plate(frames, found)] * len(chosen)
        trimmed = trim_mattes(frames[chosen], found[chosen], plates)
        images.append(lift_person(frames[chosen], trimmed, plates, "srgb"))
        mattes.append(trimmed)
        cameras.append(torch.full((len(chosen),), camera))
    frame_indices = chosen.repeat(len(images))
    return Reference(
        images=torch.cat(images),
        mattes=torch.cat(mattes),
        seen=None,
        camera_indices=torch.cat(cameras),
        frame_indices=frame_indices,
        novel_pose=(frame_indices >= clip.held_out_from).long(),
        background=(0.0, 0.0, 0.0),
        motion_times=None,
        motion=None,
    )
