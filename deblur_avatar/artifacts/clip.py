"""A video of one person: sharp (`Clip`), and blurred (`BlurryClip`).

Dimensions. F frames, C cameras, R recorded cameras, V test views, J joints, B shape numbers,
P body vertices, T triangles, N Gaussians, S instants inside one exposure.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float32, UInt8
from torch import Tensor

from deblur_avatar.artifacts.averaging_space import check_averaging_space
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.storage import Artifact


@dataclass(frozen=True, kw_only=True)
class Clip(Artifact):
    """Frames as the source recorded them. Made by `clip`.

    `frames[r]` comes from camera `recorded[r]`. A studio clip also carries what a real one cannot:
    mattes, poses, and the physically true blur of the training camera for the window asked for.
    `frame_indices` of the true blur are those frames whose window lies inside the clip. Landmarks
    are those that a user brought along.
    """

    schema: ClassVar[str] = "clip/1"
    names_on_disk: ClassVar[Mapping[str, str]] = {"averaging_space": "light"}

    frames: UInt8[Tensor, "R F H W 3"]
    mattes: UInt8[Tensor, "R F H W"] | None
    landmarks: Float32[Tensor, "R F L 3"] | None = None  # x, y (pixels), confidence; MediaPipe's 33
    recorded: tuple[int, ...]  # camera index of each stack of frames
    train_camera: int  # camera index
    cameras: Cameras
    timestamps: Float32[Tensor, " F"]  # seconds, the middle of each frame's exposure
    numbers: tuple[int, ...] | None = None  # of the frames in their file; None: 0, 1, 2, ...
    blurred: bool  # True if the frames are blurred already and `blur` must pass them through
    exposure: float | None  # seconds the shutter was open, where known
    exposure_std: float | None = None  # of its logarithm, where it is a guess; None: it is known
    averaging_space: str  # "srgb" or "linear": the space in which the camera averaged
    held_out_from: int  # frames from here on are kept from training (novel poses)
    initial: Poses | None  # poses given by the source, F of them
    exact: Poses | None  # true poses; for the method `ceiling` alone
    true_blur_srgb: UInt8[Tensor, "E H W 3"] | None
    true_blur_linear: UInt8[Tensor, "E H W 3"] | None
    true_blur_mattes: UInt8[Tensor, "E H W"] | None
    frame_indices: tuple[int, ...] | None  # E frame numbers of the true blur
    true_blur_exposure: float | None  # seconds its shutter was open: window / (factor * fps)

    def validate(self) -> None:
        """Refuse a training camera that was not recorded, times that do not increase."""
        check_averaging_space(self.averaging_space)
        if self.train_camera not in self.recorded:
            raise ValueError(f"train_camera {self.train_camera} is not among {self.recorded}")
        if len(self.recorded) != len(self.frames):
            raise ValueError(f"{len(self.frames)} stacks of frames, {len(self.recorded)} cameras")
        if len(self.timestamps) > 1 and self.timestamps.diff().min() <= 0:
            raise ValueError("timestamps must increase")
        if self.numbers is not None and len(self.numbers) != len(self.timestamps):
            raise ValueError("numbers and timestamps must be of one length")

    def numbered(self, positions: Sequence[int]) -> tuple[int, ...]:
        """What the file calls some frames."""
        return tuple(positions if self.numbers is None else (self.numbers[p] for p in positions))


@dataclass(frozen=True, kw_only=True)
class BlurryClip(Artifact):
    """Blurred frames of every recorded camera, the sharp ones at their middle, and the shutter.

    Made by `blur`. `frame_indices` say which frames of the clip they are; frames whose window
    leaves the clip are dropped. Mattes are averaged over the exposure as coverage, in either light.
    """

    schema: ClassVar[str] = "blurry_clip/1"
    names_on_disk: ClassVar[Mapping[str, str]] = {"averaging_space": "light"}

    frames: UInt8[Tensor, "R F H W 3"]
    mattes: UInt8[Tensor, "R F H W"] | None
    landmarks: Float32[Tensor, "R F L 3"] | None = None  # as in `Clip`
    sharp_frames: UInt8[Tensor, "F H W 3"] | None  # the training camera; for `oracle`, `ceiling`
    sharp_mattes: UInt8[Tensor, "F H W"] | None
    recorded: tuple[int, ...]
    train_camera: int
    cameras: Cameras
    frame_indices: tuple[int, ...]
    timestamps: Float32[Tensor, " F"]
    exposure: float | None
    exposure_std: float | None = None  # as in `Clip`
    averaging_space: str
    held_out_from: int  # position in this clip of the first frame kept from training
    initial: Poses | None
    exact: Poses | None

    def validate(self) -> None:
        """Refuse an unknown light and a clip without a training frame."""
        check_averaging_space(self.averaging_space)
        if len(self.frame_indices) != len(self.timestamps):
            raise ValueError("frame_indices and timestamps must be of one length")
        if self.held_out_from < 1:
            raise ValueError("no frame is left for training; shorten the blur window")
