"""Training data: one camera's frames, soft mattes and poses.

Dimensions. F frames, B backgrounds (one of a still camera, or one a frame), C cameras, R recorded
cameras, V test views, J joints, P body vertices, T triangles, N Gaussians,
S instants inside one exposure.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float32, UInt8
from torch import Tensor

from deblur_avatar.artifacts.averaging_space import check_averaging_space
from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.cameras import Cameras
from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.artifacts.storage import Artifact
from deblur_avatar.geometry.cameras import Camera


@dataclass(frozen=True, kw_only=True)
class Observations(Artifact):
    """All that fitting sees: one camera's frames, soft mattes and poses. Made by `preprocess`.

    Frames show the person in front of `backgrounds`, or on black where there are none. They are
    undistorted, cropped to the person and scaled: crop `crops[c]` (x, y, width, height
    in pixels of the clip) of camera c was scaled to `cameras.sizes[c]`. All frames of the clip are
    here, so that poses are known throughout; only `train` are fitted and `validation` are set
    aside.
    `weights` in [0, 1] say how far a frame's pose is to be trusted; 0 for frames without a person.
    `depth_known`: the poses tell how far joints are from the camera better than one camera can.
    `pose_std` is how far those poses may be off: the root mean square of a joint's angle of error,
    radians, as whoever gave them says.
    `occluded_fraction` is the share of the body's surface that the training camera sees in no
    training frame.
    """

    schema: ClassVar[str] = "observations/4"
    names_on_disk: ClassVar[Mapping[str, str]] = {
        "averaging_space": "light",
        "occluded_fraction": "hidden",
    }

    frames: UInt8[Tensor, "F H W 3"]
    mattes: UInt8[Tensor, "F H W"]
    comparable: UInt8[Tensor, "F H W"] | None  # 255 where colours mean something; None: everywhere
    backgrounds: UInt8[Tensor, "B H W 3"] | None  # sRGB; None: black
    cameras: Cameras  # all cameras of the source, without distortion
    crops: Float32[Tensor, "C 4"]
    train_camera: int
    body: Body
    poses: Poses  # initial estimates, one a frame
    weights: Float32[Tensor, " F"]
    frame_indices: tuple[int, ...]
    timestamps: Float32[Tensor, " F"]
    exposure: float | None
    exposure_std: float | None = None  # of its logarithm, where it is a guess; None: it is known
    averaging_space: str
    train: tuple[int, ...]  # positions in this artifact
    validation: tuple[int, ...]
    depth_known: bool
    pose_std: float
    occluded_fraction: float

    @property
    def camera(self) -> Camera:
        """The training camera."""
        return self.cameras.camera(self.train_camera)

    @property
    def shown(self) -> list[int]:
        """Positions of the training frames that show a person."""
        return [index for index in self.train if self.weights[index] > 0]

    def background(self, position: int) -> UInt8[Tensor, "H W 3"] | None:
        """What is behind the person in one frame, sRGB; None is black."""
        if self.backgrounds is None:
            return None
        return self.backgrounds[0 if len(self.backgrounds) == 1 else position]

    def comparable_part(
        self, image: Float32[Tensor, "H W 3"], position: int
    ) -> Float32[Tensor, "H W 3"]:
        """A frame in [0, 1] or a render of it, black where colours mean nothing."""
        if self.comparable is None:
            return image
        return image * (self.comparable[position].to(image) / 255)[..., None]

    def comparable_frames(self) -> UInt8[Tensor, "F H W 3"]:
        """All frames, black where colours mean nothing."""
        if self.comparable is None:
            return self.frames
        return torch.where(self.comparable[..., None] > 127, self.frames, 0)

    def validate(self) -> None:
        """Refuse an unknown light, an empty training set, frames in two roles."""
        check_averaging_space(self.averaging_space)
        if not self.train:
            raise ValueError("no training frame; check masks and the blur window")
        if set(self.train) & set(self.validation):
            raise ValueError("train and validation must not share frames")
        held = 1 if self.backgrounds is None else len(self.backgrounds)
        if held not in (1, len(self.frames)):
            raise ValueError(
                f"backgrounds: {held} pictures; want one, or one a frame ({len(self.frames)})"
            )
