"""Which optimiser moves which unknown, and how fast."""

import torch

from deblur_avatar.avatar.model import AvatarModel
from deblur_avatar.avatar.motion import Trajectory
from deblur_avatar.config import StartParams
from deblur_avatar.fitting.fusion_network import FusionNetwork

ADAM_EPSILON = 1e-15  # 3DGS: gradients of means are tiny


def gaussian_optimiser(model: AvatarModel, params: StartParams) -> torch.optim.Adam:
    """The Gaussians' own: a group each for means, quats, log_scales, opacities, features."""
    rates = params.optimiser
    chosen = {
        "means": rates.means,
        "quats": rates.quats,
        "log_scales": rates.scales,
        "opacity_logits": rates.opacities,
        "features": rates.features,
    }
    groups = [
        {"params": [value], "lr": chosen[name], "name": name}
        for name, value in model.gaussians.named_parameters()
    ]
    return torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True)


def network_optimiser(
    model: AvatarModel,
    trajectory: Trajectory,
    fusion: FusionNetwork | None,
    params: StartParams,
) -> torch.optim.Adam:
    """Everything else's: networks, motion, fusion; a group a parameter, named after it."""
    rates = params.optimiser
    groups: list[dict[str, object]] = []
    for prefix, rate in (
        ("skinning", rates.rigid),
        ("nonrigid", rates.nonrigid),
        ("pose_encoder", rates.nonrigid),
        ("color", rates.color),
    ):
        for name, value in model.named_parameters():
            if name.startswith(f"{prefix}."):
                decay = rates.latent_decay if "latents" in name else 0.0
                named = {"name": f"network.{name}", "weight_decay": decay}
                groups.append({"params": [value], "lr": rate} | named)
    for name, value in trajectory.named_parameters():
        if value.requires_grad:
            rate = {"transl": rates.transl, "shutter": rates.shutter}.get(
                name.rpartition("_")[2], rates.poses
            )
            groups.append({"params": [value], "lr": rate, "name": f"motion.{name}"})
    if fusion is not None:
        for name, value in fusion.named_parameters():
            groups.append({"params": [value], "lr": rates.fusion, "name": f"fusion.{name}"})
    if not groups:
        still = torch.nn.Parameter(torch.zeros(1))
        groups.append({"params": [still], "lr": 0.0, "name": "nothing"})
    return torch.optim.Adam(groups, eps=ADAM_EPSILON, fused=True)
