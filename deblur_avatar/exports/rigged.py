"""Rigged avatar: Gaussians on a skeleton, as programs know it that have no networks.

An avatar without networks is a set of Gaussians that the body's own weights move, so that it can be
taken out whole: whoever has the joints' rotations can pose it.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.kinds import avatar_from_artifact
from deblur_avatar.avatars.plain_avatar import COLORS, PlainAvatar
from deblur_avatar.bodies.posed_body import shaped_joints
from deblur_avatar.errors import ConfigError
from deblur_avatar.exports.exporter import FittedRun

RIGGED = (PlainAvatar,)  # whose Gaussians depend on neither pose, frame nor view


@dataclass(frozen=True)
class RiggedAvatar:
    """N canonical Gaussians, J joints and the weights between them."""

    model: AvatarModel
    means: Float[Tensor, "N 3"]
    quats: Float[Tensor, "N 4"]  # wxyz, of unit length
    log_scales: Float[Tensor, "N 3"]
    opacities: Float[Tensor, " N"]
    colors: Float[Tensor, "N 3"]  # in the averaging space
    averaging_space: str
    lbs_weights: Float[Tensor, "N J"]
    joints: Float[Tensor, "J 3"]  # at rest
    rest_from_canonical: Float[Tensor, "J 4 4"]


def rigged_avatar(run: FittedRun) -> RiggedAvatar:
    """Take the rig out of a fitted run; no gradients.

    Raises:
        ConfigError: if no skeleton poses its avatar, which has networks or says why
            (`beyond_a_rig`).
    """
    body = run.observations.body
    model = avatar_from_artifact(run.avatar, body, torch.device("cpu"))
    if not isinstance(model, RIGGED):
        why = getattr(model, "beyond_a_rig", "whose networks no skeleton carries")
        raise ConfigError(
            f"export: {run.name} is an avatar of kind {model.kind}, {why}; "
            "take a run of a plain avatar (lean), or --format ply, one pose"
        )
    with torch.no_grad():
        own = model.gaussians
        return RiggedAvatar(
            model=model,
            means=own.means.clone(),
            quats=torch.nn.functional.normalize(own.quats, dim=1),
            log_scales=own.log_scales.clone(),
            opacities=own.opacities.clone(),
            colors=own.features[:, :COLORS].sigmoid(),
            averaging_space=model.averaging_space,
            lbs_weights=model.weights_at(own.means),
            joints=shaped_joints(body, model.betas),
            rest_from_canonical=model.rest_from_canonical,
        )
