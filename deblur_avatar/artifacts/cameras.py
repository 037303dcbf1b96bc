"""Calibrated cameras: intrinsics, extrinsics, distortion."""

from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float32, Int64
from torch import Tensor

from deblur_avatar.artifacts.storage import Artifact
from deblur_avatar.geometry.cameras import Camera, check_cameras


@dataclass(frozen=True, kw_only=True)
class Cameras(Artifact):
    """Where cameras stand and how they see; the true principal point is kept.

    `distortion` is OpenCV's (k1, k2, p1, p2, k3); all zero after `preprocess`.
    """

    schema: ClassVar[str] = "cameras/1"

    Ks: Float32[Tensor, "C 3 3"]  # pixels
    viewmats: Float32[Tensor, "C 4 4"]  # world to camera
    distortion: Float32[Tensor, "C 5"]
    sizes: Int64[Tensor, "C 2"]  # width, height in pixels
    names: tuple[str, ...]

    def validate(self) -> None:
        """Refuse cameras that cannot exist."""
        if len(self.names) != len(self.Ks):
            raise ValueError(f"{len(self.Ks)} cameras have {len(self.names)} names")
        check_cameras(self.Ks, self.viewmats)

    @property
    def world_is_a_cameras(self) -> bool:
        """Whether the world's axes are those of one of the cameras, so that none is gravity's."""
        axes = torch.eye(3).to(self.viewmats)
        return bool((self.viewmats[:, :3, :3] == axes).all(dim=(1, 2)).any())

    def camera(self, index: int) -> Camera:
        """One of them."""
        width, height = self.sizes[index].tolist()
        return Camera(self.Ks[index], self.viewmats[index], width, height)
