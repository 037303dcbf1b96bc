"""Pinhole cameras: from the world to pixels and back.

Conventions. OpenCV axes: +X right, +Y down, +Z forward. `viewmats` go from world to camera, metres.
`Ks` are in pixels with the centre of the top left pixel at (0.5, 0.5), so that scaling an image by
s scales every entry of K's first two rows by s.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

MINIMUM_DEPTH = 1e-6  # metres; a point nearer than this has no picture


@dataclass(frozen=True)
class Camera:
    """One pinhole camera and the size of its picture.

    `binning` is how many pixels' sides of the full-size picture one side of its pixels is.
    """

    K: Float[Tensor, "3 3"]  # pixels
    viewmat: Float[Tensor, "4 4"]  # world to camera
    width: int
    height: int
    binning: float = 1.0

    def to(self, like: Tensor | torch.device) -> "Camera":
        """The same camera where another tensor is, or on a device."""
        return replace(self, K=self.K.to(like), viewmat=self.viewmat.to(like))

    def binned(self, share: float) -> "Camera":
        """The camera of a picture `share` times as large, whose pixels see averages."""
        width, height = (max(1, round(side * share)) for side in (self.width, self.height))
        scale = self.K.new_tensor([width / self.width, height / self.height, 1.0])
        return Camera(scale[:, None] * self.K, self.viewmat, width, height, self.binning / share)


def project(
    points: Float[Tensor, "*batch P 3"], K: Float[Tensor, "3 3"], viewmat: Float[Tensor, "4 4"]
) -> tuple[Float[Tensor, "*batch P 2"], Float[Tensor, "*batch P"]]:
    """Project world points into one camera: pixel positions, and depths in metres.

    Points at or behind the camera get the pixel they would have at `MINIMUM_DEPTH`; their depth
    (<= 0) says so.
    """
    seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    depth = seen[..., 2]
    homogeneous = seen @ K.T
    return homogeneous[..., :2] / depth.clamp(min=MINIMUM_DEPTH)[..., None], depth


def camera_centres(viewmats: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 3"]:
    """Where cameras stand in the world, metres."""
    rotation = viewmats[..., :3, :3]
    return -(rotation.transpose(-1, -2) @ viewmats[..., :3, 3:])[..., 0]


def pixel_rays(
    K: Float[Tensor, "3 3"], viewmat: Float[Tensor, "4 4"], pixels: Float[Tensor, "P 2"]
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]:
    """Cast a ray through each pixel position: origins, and unit directions in the world."""
    homogeneous = torch.cat([pixels, torch.ones_like(pixels[:, :1])], dim=-1)
    directions = torch.linalg.solve(K, homogeneous.T).T @ viewmat[:3, :3]
    origins = camera_centres(viewmat).expand_as(directions)
    return origins, torch.nn.functional.normalize(directions, dim=-1)


def look_at(
    eye: Float[Tensor, " 3"], target: Float[Tensor, " 3"], up: Float[Tensor, " 3"]
) -> Float[Tensor, "4 4"]:
    """Build the viewmat of a camera at `eye` that looks at `target` with `up` upwards in the image.

    Raises:
        ValueError: if `eye` equals `target`, or the view is along `up`.
    """
    forward = target - eye
    right = torch.linalg.cross(forward, up)
    if min(forward.norm(), right.norm()) < MINIMUM_DEPTH:
        raise ValueError("look_at needs eye != target and a view direction that is not along up")
    forward, right = forward / forward.norm(), right / right.norm()
    down = torch.linalg.cross(forward, right)
    viewmat = torch.eye(4, dtype=eye.dtype, device=eye.device)
    viewmat[:3, :3] = torch.stack([right, down, forward])
    viewmat[:3, 3] = -(viewmat[:3, :3] @ eye)
    return viewmat


def crop_intrinsics(
    K: Float[Tensor, "3 3"], x: float, y: float, scale: float
) -> Float[Tensor, "3 3"]:
    """Intrinsics after cutting (x, y) pixels off the left and top, then scaling the image."""
    shifted = K.clone()
    shifted[0, 2] -= x
    shifted[1, 2] -= y
    shifted[:2] *= scale
    return shifted


def check_cameras(Ks: Float[Tensor, "C 3 3"], viewmats: Float[Tensor, "C 4 4"]) -> None:
    """Refuse cameras that cannot exist.

    Raises:
        ValueError: for values that are not finite, focal lengths that are not positive, rotations
            that are not orthonormal or mirror the world; names the camera.
    """
    for index in range(len(Ks)):
        K, viewmat = Ks[index].double(), viewmats[index].double()
        if not (torch.isfinite(K).all() and torch.isfinite(viewmat).all()):
            raise ValueError(f"camera {index}: K and viewmat must be finite")
        if not (K[0, 0] > 0 and K[1, 1] > 0):
            raise ValueError(f"camera {index}: focal lengths must be positive, got {K[0, 0]:.6g}")
        rotation = viewmat[:3, :3]
        determinant = torch.linalg.det(rotation)
        if determinant < 0:
            raise ValueError(
                f"camera {index}: det(R) = {determinant:.3f} mirrors the world; check the axes "
                "(OpenCV: +X right, +Y down, +Z forward)"
            )
        if (rotation @ rotation.T - torch.eye(3).double()).abs().max() > 1e-3:
            raise ValueError(f"camera {index}: R is not a rotation matrix")
