"""Posed Gaussians: an avatar in one pose, as any 3D Gaussian splatting program knows it."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.artifacts.poses import Poses
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.splats import SplatAvatar
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun
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
        ConfigError: if the avatar is no set of Gaussians of one colour each.
    """
    model = _splats(model)
    device = model.betas.device
    with torch.no_grad():
        rotations = axis_angle_to_matrix(pose.axis_angle)
        transforms = model.transforms(rotations, pose.transl)
        frame = model.frames - 1 if frame < 0 else frame
        state = model.condition(rotations[0].to(device), frame, transforms[0], viewmat.to(device))
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


def posed_frame(run: FittedRun, frame: int) -> PosedGaussians:
    """The avatar of a run at the middle of one frame's exposure, as the training camera sees it.

    Raises:
        ConfigError: if there is no such frame, or the avatar is no set of Gaussians.
    """
    count = len(run.motion.timestamps)
    if frame >= count:
        raise ConfigError(
            f"export: frame {frame} of {count}; frames are counted from 0 to {count - 1}"
        )
    return next(posed_motion(run, run.motion.centre.at([frame])))


def posed_motion(run: FittedRun, poses: Poses) -> Iterator[PosedGaussians]:
    """The avatar of a run in one pose after the other, as the training camera sees it.

    Raises:
        ConfigError: if the avatar is no set of Gaussians of one colour each.
    """
    observations = run.observations
    model = avatar_from_artifact(run.avatar, observations.body, torch.device("cpu"))
    for index in range(len(poses.transl)):
        yield posed_gaussians(model, poses.at([index]), observations.camera.viewmat)


def canonical_colors(
    model: AvatarModel, viewmat: Float[Tensor, "4 4"]
) -> tuple[Float[Tensor, "N 3"], Float[Tensor, "N 3"], Float[Tensor, " N"]]:
    """Where Gaussians are in the canonical pose, their sRGB colours there, their opacities.

    Raises:
        ConfigError: if the avatar is no set of Gaussians of one colour each.
    """
    model = _splats(model)
    joints = len(model.body.parents)
    still = Poses(
        betas=model.betas,
        global_orient=torch.zeros(1, 3),
        body_pose=torch.zeros(1, joints - 1, 3),
        transl=torch.zeros(1, 3),
    )
    gaussians = posed_gaussians(model, still, viewmat)
    return model.gaussians.means.detach().cpu(), gaussians.colors, gaussians.opacities


def _splats(model: AvatarModel) -> SplatAvatar:
    if not isinstance(model, SplatAvatar):
        raise ConfigError(
            f"an avatar of kind {model.kind} is no set of Gaussians of one colour each, and such "
            "files hold nothing else; videos and the live viewer (deblur-avatar view) show it"
        )
    return model


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
