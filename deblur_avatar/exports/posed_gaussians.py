"""Posed Gaussians: an avatar in one pose, as any 3D Gaussian splatting program knows it."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.splats import SplatAvatar
from deblur_avatar.errors import ConfigError
from deblur_avatar.geometry.rotations import axis_angle_to_matrix, matrix_to_quat
from deblur_avatar.imaging.color import linear_to_srgb
from deblur_avatar.rendering.covariances import whole_matrices

MIN_VARIANCE = 1e-14  # square metres; a tenth of a micrometre, far below any pixel


@dataclass(frozen=True)
class PosedGaussians:
    """N Gaussians in world space, metres."""

    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]  # wxyz, of unit length
    scales: Float[Tensor, "N 3"]  # standard deviations
    opacities: Float[Tensor, " N"]
    colors: Float[Tensor, "N 3"]  # sRGB in [0, 1]


def posed_gaussians(
    model: AvatarModel, pose: Poses, viewmat: Float[Tensor, "4 4"], frame: int = -1
) -> PosedGaussians:
    """Pose an avatar and take its Gaussians out; no gradients.

    Colours that depend on the view are those seen from one camera. An avatar that averages linear
    light gets each colour as sRGB, which other programs blend without turning it into light.

    Args:
        model: whom to pose.
        pose: one; its shape numbers are ignored in favour of the avatar's.
        viewmat: the camera, world to camera.
        frame: training position whose latent code the colours are of; -1 for the last.

    Raises:
        ConfigError: if the avatar is not made of Gaussians.
    """
    if not isinstance(model, SplatAvatar):
        raise ConfigError(f"an avatar of kind {model.kind} has no Gaussians to take out")
    device = model.betas.device
    with torch.no_grad():
        rotations = axis_angle_to_matrix(pose.axis_angle).to(device)
        transforms = model.transforms(rotations, pose.transl.to(device))
        frame = model.frames - 1 if frame < 0 else frame
        state = model.condition(rotations[0], frame, transforms[0], viewmat.to(device))
        means, covars = state.posed(transforms)
        colors = state.colors.clamp(0, 1)
        quats, scales = axes_of(whole_matrices(covars[0]))
        return PosedGaussians(
            means=means[0].cpu(),
            quats=quats.cpu(),
            scales=scales.cpu(),
            opacities=model.gaussians.opacities.cpu(),
            colors=(linear_to_srgb(colors) if model.averaging_space == "linear" else colors).cpu(),
        )


def axes_of(
    covars: Float[Tensor, "N 3 3"],
) -> tuple[Float[Tensor, "N 4"], Float[Tensor, "N 3"]]:
    """Split covariances into rotations (wxyz) and standard deviations along the rotated axes.

    Skinning blends rotations, so a posed covariance is no longer a rotated canonical one; its
    eigenvectors are the axes that say the same.
    """
    variances, axes = torch.linalg.eigh(covars.double())
    axes = axes * torch.where(torch.linalg.det(axes) < 0, -1.0, 1.0)[:, None, None]  # no mirrors
    scales = variances.clamp(min=MIN_VARIANCE).sqrt()
    return matrix_to_quat(axes).to(covars.dtype), scales.to(covars.dtype)
