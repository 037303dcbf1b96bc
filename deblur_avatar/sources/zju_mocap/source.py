"""ZJU-MoCap source: a sequence becomes a sharp clip and its test views.

Frame f of the clip is entry `frames[0] + f * stride` of `annots.npy`. The clip keeps the lens'
distortion and the true intrinsics, which `preprocess` takes out; test views are straight and show
the person on black. Pictures are scaled down to `image_height` after masking.
"""

import logging
from pathlib import Path
from typing import Annotated, Literal

import torch
from jaxtyping import UInt8
from pydantic import Field
from torch import Tensor

from deblur_avatar import run
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.config.reading import missing_file
from deblur_avatar.config.section import Count, Fraction, Params, Positive
from deblur_avatar.errors import ArtifactError, ConfigError
from deblur_avatar.frame_numbers import spans
from deblur_avatar.imaging.resampling import crop_and_scale, undistort
from deblur_avatar.sources.folders import footage_folder
from deblur_avatar.sources.source import Segment
from deblur_avatar.sources.zju_mocap.annotations import Annotations, read_annotations
from deblur_avatar.sources.zju_mocap.pictures import (
    mask_folders_here,
    picture_size,
    read_person,
)
from deblur_avatar.sources.zju_mocap.poses import read_poses


class ZjuMocapParams(Params):
    """A sequence in ZJU-MoCap's raw layout (docs/zju-mocap.md).

    `root` may hold `$(VARIABLE:-default)`. Cameras are counted from 0 in the order of `annots.npy`,
    frames as it lists them.
    """

    source: Literal["zju_mocap"]
    root: str
    frames: tuple[Annotated[int, Field(ge=0)], int | None]  # first, one past last (null: all)
    stride: Count  # every n-th of them is a frame of the clip
    fps: Positive  # of the recording
    image_height: Count  # pictures that are taller are scaled down to this
    train_camera: Annotated[int, Field(ge=0)]
    test_cameras: tuple[Annotated[int, Field(ge=0)], ...] | Literal["all"]  # all others
    test_stride: Count  # frames of the clip between two test views
    pose_cameras: tuple[Annotated[int, Field(ge=0)], ...]  # recorded too, for estimated poses
    mask_folders: Annotated[tuple[Literal["mask", "mask_cihp"], ...], Field(min_length=1)]
    mask_dilation: Annotated[int, Field(ge=0)]  # pixels of the pictures as filmed
    background: Literal["black", "filmed"]  # of the clip; black is what masks leave out
    poses: Literal["new_params", "none"]
    held_out: Fraction  # last part of the clip, kept from training

    def load(
        self, body: Body, segment: Segment, generator: torch.Generator
    ) -> tuple[Clip, Reference]:
        """Read the sequence, whose mattes come with it."""
        return load_zju_mocap(self, body)

    def missing_files(self, where: str) -> tuple[str, ...]:
        """The sequence's folder, where it is not here."""
        return missing_file(self.root, f"{where}.root", "folder", folder=True)


logger = logging.getLogger(__name__)

REMEDY = (
    "the sequences are (a folder with annots.npy; for ZJU-MoCap itself see docs/zju-mocap.md, its "
    "owners give it out on request)"
)


def load_zju_mocap(params: ZjuMocapParams, body: Body) -> tuple[Clip, Reference]:
    """Read the recorded cameras' frames, the poses given, and the test cameras' views.

    Raises:
        ConfigError: if the root is missing or the parameters do not fit the sequence.
        ArtifactError: if a file is missing, damaged, or contradicts another.
    """
    root = footage_folder(params.root, REMEDY)
    annotations = read_annotations(root / "annots.npy")
    frames = _frames(params, annotations)
    recorded, tested = _chosen_cameras(params, annotations)
    used = sorted({*recorded, *tested})
    numbers = annotations.frame_numbers(frames, used)
    folders = mask_folders_here(root, params.mask_folders)
    sequence = _Sequence(root, annotations, folders, params, used)
    cameras = sequence.cameras()
    stacks = [sequence.recorded_stack(camera, frames) for camera in recorded]
    train = used.index(params.train_camera)
    _warn_of_repeats(stacks[recorded.index(params.train_camera)][0], numbers)
    count = len(frames)
    clip = Clip(
        frames=torch.stack([pictures for pictures, _ in stacks]),
        mattes=torch.stack([mattes for _, mattes in stacks]),
        recorded=tuple(used.index(camera) for camera in recorded),
        train_camera=train,
        cameras=cameras,
        timestamps=torch.arange(count) * (params.stride / params.fps),
        blurred=False,
        exposure=None,
        averaging_space="linear",
        held_out_from=max(1, round(count * (1 - params.held_out))),
        initial=read_poses(root, numbers, body) if params.poses == "new_params" else None,
        exact=None,
        true_blur_srgb=None,
        true_blur_linear=None,
        true_blur_mattes=None,
        frame_indices=None,
        true_blur_exposure=None,
    )
    return clip, _reference(sequence, clip, tested, frames[:: params.test_stride])


class _Sequence:
    """The pictures of the cameras that are used, all of one size."""

    def __init__(
        self,
        root: Path,
        annotations: Annotations,
        folders: list[str],
        params: ZjuMocapParams,
        used: list[int],
    ) -> None:
        self.root, self.annotations, self.folders = root, annotations, folders
        self.params, self.used = params, used
        self.filmed_size = picture_size(root, annotations.pictures[0][used[0]])
        shrink = min(1.0, params.image_height / self.filmed_size[1])
        width, height = (max(1, round(shrink * side)) for side in self.filmed_size)
        self.size = (width, height)

    def cameras(self) -> Cameras:
        """Of the scaled pictures, in the order of `used`."""
        Ks = self.annotations.Ks[self.used].clone()
        Ks[:, 0] *= self.size[0] / self.filmed_size[0]
        Ks[:, 1] *= self.size[1] / self.filmed_size[1]
        return Cameras(
            Ks=Ks,
            viewmats=self.annotations.viewmats[self.used],
            distortion=self.annotations.distortion[self.used],
            sizes=torch.tensor([self.size] * len(self.used)),
            names=tuple(self.annotations.camera_name(camera) for camera in self.used),
        )

    def filmed(self, camera: int, frame: int, on_black: bool) -> tuple[Tensor, Tensor]:
        """A picture and its matte as filmed."""
        name = self.annotations.pictures[frame][camera]
        dilation = self.params.mask_dilation
        picture, matte = read_person(self.root, name, self.folders, dilation, on_black)
        height, width = matte.shape
        if (width, height) != self.filmed_size:
            raise ArtifactError(
                f"{self.root / name} has {width} x {height} pixels, other pictures "
                f"{self.filmed_size[0]} x {self.filmed_size[1]}; all cameras must film one size"
            )
        return picture, matte

    def scaled(self, images: UInt8[Tensor, "F H W *channels"]) -> UInt8[Tensor, "F h w *channels"]:
        """Scale to the size of the clip."""
        return crop_and_scale(images, (0, 0, *self.filmed_size), self.size)

    def recorded_stack(
        self, camera: int, frames: range
    ) -> tuple[UInt8[Tensor, "F H W 3"], UInt8[Tensor, "F H W"]]:
        """All frames of one camera with their mattes, distorted as filmed."""
        width, height = self.size
        pictures = torch.empty((len(frames), height, width, 3), dtype=torch.uint8)
        mattes = torch.empty((len(frames), height, width), dtype=torch.uint8)
        on_black = self.params.background == "black"
        name = f"read {self.annotations.camera_name(camera)}"
        for position, frame in enumerate(run.progress(frames, name)):
            picture, matte = self.filmed(camera, frame, on_black)
            pictures[position] = self.scaled(picture[None])[0]
            mattes[position] = self.scaled(matte[None])[0]
        return pictures, mattes

    def straight_views(
        self, camera: int, frames: range
    ) -> tuple[UInt8[Tensor, "F H W 3"], UInt8[Tensor, "F H W"]]:
        """Some frames of one camera without distortion, the person on black."""
        lens = self.annotations.Ks[camera], self.annotations.distortion[camera]
        views = [self.filmed(camera, frame, on_black=True) for frame in frames]
        pictures, mattes = (torch.stack(column) for column in zip(*views, strict=True))
        return self.scaled(undistort(pictures, *lens)), self.scaled(undistort(mattes, *lens))


def _frames(params: ZjuMocapParams, annotations: Annotations) -> range:
    count = len(annotations.pictures)
    first, stop = params.frames
    frames = range(first, count if stop is None else stop, params.stride)
    if len(frames) < 2 or frames[-1] >= count:
        raise ConfigError(
            f"clip.frames: {first} to {stop} in steps of {params.stride} must be two frames or "
            f"more of the {count} that {annotations.path} lists"
        )
    return frames


def _chosen_cameras(
    params: ZjuMocapParams, annotations: Annotations
) -> tuple[list[int], list[int]]:
    """The cameras recorded, the training one first, and those tested."""
    count = len(annotations.Ks)
    train = params.train_camera
    others = tuple(camera for camera in range(count) if camera != train)
    tested = others if params.test_cameras == "all" else params.test_cameras
    for key, cameras in (
        ("train_camera", (train,)),
        ("test_cameras", tested),
        ("pose_cameras", params.pose_cameras),
    ):
        if not all(camera < count for camera in cameras) or len(set(cameras)) < len(cameras):
            raise ConfigError(
                f"clip.{key}: {list(cameras)} must be different ones of {annotations.path}'s "
                f"{count} cameras, counted from 0"
            )
    if train in tested or not tested:
        raise ConfigError(
            f"clip.test_cameras: {list(tested)} must be one camera or more, without the training "
            f"camera {train}"
        )
    if train in params.pose_cameras:
        raise ConfigError(f"clip.pose_cameras: the training camera {train} is recorded anyway")
    return [train, *params.pose_cameras], list(tested)


def _warn_of_repeats(pictures: UInt8[Tensor, "F H W 3"], numbers: list[int]) -> None:
    """A camera that sends a picture twice makes motion jump; a person may also stand still."""
    same = (pictures[1:] == pictures[:-1]).flatten(1).all(1)
    repeated = [numbers[int(index) + 1] for index in torch.nonzero(same).flatten()]
    if repeated:
        logger.warning(
            "%d frames repeat the picture before them: %s; if the person does not stand still, "
            "keep clip.frames free of them",
            len(repeated),
            spans(repeated),
        )


def _reference(sequence: _Sequence, clip: Clip, tested: list[int], frames: range) -> Reference:
    """Every test camera's view of every `test_stride`-th frame."""
    images, mattes = [], []
    for camera in run.progress(tested, "read test views"):
        pictures, covers = sequence.straight_views(camera, frames)
        images.append(pictures)
        mattes.append(covers)
    chosen = torch.arange(0, len(clip.timestamps), sequence.params.test_stride)
    frame_indices = chosen.repeat(len(tested))
    indices = torch.tensor([sequence.used.index(camera) for camera in tested])
    return Reference(
        images=torch.cat(images),
        mattes=torch.cat(mattes),
        seen=None,
        camera_indices=indices.repeat_interleave(len(chosen)),
        frame_indices=frame_indices,
        novel_pose=(frame_indices >= clip.held_out_from).long(),
        background=(0.0, 0.0, 0.0),
        motion_times=None,
        motion=None,
    )
