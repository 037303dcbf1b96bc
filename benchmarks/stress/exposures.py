"""What only networks can get wrong inside an exposure: how two renders blend, and when they look.

The paper blends a sharp and an averaged render by a network that nothing supervises: its share of
the averaged one, M, should follow the blur. And it evaluates the avatar's networks once an
exposure, at the middle, for all instants.
"""

from collections.abc import Sequence
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor

from benchmarks.stress.fit import Fitted
from deblur_avatar.artifacts.observations import Observations
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.networks_avatar import NetworksAvatar
from deblur_avatar.avatars.render import render_avatar
from deblur_avatar.bodies.posed_body import posed
from deblur_avatar.evaluation.instants import exposure_of
from deblur_avatar.evaluation.reblur import reblurred
from deblur_avatar.geometry.cameras import project
from deblur_avatar.imaging.exposure import AveragingSpace, expose
from deblur_avatar.imaging.metrics import psnr
from deblur_avatar.motion.kinds import trajectory_from_artifact
from deblur_avatar.motion.trajectory import Trajectory
from deblur_avatar.training.fusion_network import FusionNetwork

EVERY = 4  # training frames: as many as a mean needs
TRUE_INSTANTS = 9  # of an exposure that a path on the screen is measured at


def blend_measures(
    observations: Observations, reference: Reference, fitted: Fitted, device: torch.device
) -> dict[str, float | None]:
    """How a fusion network blends, over the pixels that either render covers.

    Returns:
        `blend_mean`, the mean share of the averaged render, and `blend_correlation`, Pearson's
        with how far the true body moved there during the exposure; None without a network, or
        where it answers alike everywhere.
    """
    if fitted.blend is None:
        return {"blend_mean": None, "blend_correlation": None}
    model = avatar_from_artifact(fitted.avatar, observations.body, device)
    trajectory = trajectory_from_artifact(fitted.motion).to(device)
    shares, paths = [], []
    for position in observations.train[::EVERY]:
        share, covered = _share(model, trajectory, fitted.blend, observations, position)
        shares.append(share[covered])
        paths.append(true_blur(observations, reference, position)[covered])
    blended, blurred = torch.cat(shares), torch.cat(paths)
    correlation = float(torch.corrcoef(torch.stack([blended, blurred]))[0, 1])
    known = correlation == correlation  # not a number where one of both never changes
    return {
        "blend_mean": float(blended.mean()),
        "blend_correlation": correlation if known else None,
    }


def _share(
    model: AvatarModel,
    trajectory: Trajectory,
    network: FusionNetwork,
    observations: Observations,
    position: int,
) -> tuple[Float[Tensor, "H W"], Tensor]:
    """M in every pixel of one frame, and which pixels are covered."""
    camera = observations.camera.to(model.betas.device)
    with torch.no_grad():
        instants = trajectory(position)
        centre = instants.centre_rotations
        rotations = torch.cat([instants.rotations, centre[None]])
        transl = torch.cat([instants.transl, instants.centre_transl[None]])
        transforms = model.transforms(rotations, transl)
        state = model.condition(centre, position, transforms[-1], camera.viewmat)
        mean, middle = model.render_exposure(state, transforms, camera, average=True)
        covered = (mean.alpha > 0).any(0) | (middle.alpha[0] > 0)
        code = state.pose_code if network.sees_pose else None
        share = network(middle.image[0], covered, code, position)
    return share[..., 0].cpu(), covered.cpu()


def true_blur(
    observations: Observations, reference: Reference, position: int
) -> Float[Tensor, "H W"]:
    """How far the body moved on the screen during one exposure, pixels, in every pixel.

    That of the vertex which lies nearest at the middle.
    """
    assert reference.motion is not None  # the studio knows it
    assert reference.motion_times is not None
    assert observations.exposure is not None
    middle = observations.timestamps[position]
    wanted = middle + observations.exposure * (torch.linspace(0, 1, TRUE_INSTANTS) - 0.5)
    nearest = (reference.motion_times[None] - wanted[:, None]).abs().argmin(1)
    camera = observations.camera
    vertices = posed(observations.body, reference.motion.at(nearest.tolist())).vertices
    pixels = torch.stack([project(shape, camera.K, camera.viewmat)[0] for shape in vertices])
    lengths = pixels.diff(dim=0).norm(dim=-1).sum(0)
    rows, columns = torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5
    grid = torch.stack(torch.meshgrid(columns, rows, indexing="xy"), -1).reshape(-1, 2)
    here = pixels[TRUE_INSTANTS // 2]
    return lengths[torch.cdist(grid, here).argmin(1)].reshape(camera.height, camera.width)


def shared_condition_db(
    observations: Observations, fitted: Fitted, device: torch.device
) -> float | None:
    """What re-blurred frames gain by conditioning an exposure once, PSNR over training frames, dB.

    Nought if the networks would say the same at every instant. None for avatars that have none,
    and for motions of one instant.
    """
    model = avatar_from_artifact(fitted.avatar, observations.body, device)
    if not isinstance(model, NetworksAvatar) or len(fitted.motion.u) == 1:
        return None
    positions = observations.train[::EVERY]
    shared = [reblurred(model, observations, fitted.motion, p)[0] for p in positions]
    apart = [_each_by_itself(model, observations, fitted, position) for position in positions]
    return _score(observations, positions, shared) - _score(observations, positions, apart)


def _each_by_itself(
    model: AvatarModel, observations: Observations, fitted: Fitted, position: int
) -> Float[Tensor, "H W 3"]:
    """One exposure's averaged render, every instant conditioned for its own pose."""
    poses = exposure_of(fitted.motion, position)
    images, _ = render_avatar(model, poses, observations.camera, frame=position)
    return expose(images, cast(AveragingSpace, observations.averaging_space)).cpu()


def _score(
    observations: Observations, positions: Sequence[int], images: Sequence[Float[Tensor, "H W 3"]]
) -> float:
    scores = [
        float(psnr(image[None], observations.frames[position][None].float() / 255))
        for position, image in zip(positions, images, strict=True)
    ]
    return sum(scores) / len(scores)
