"""Registry of avatars: each kind by the name that it has in `params.yaml` and on disk."""

from typing import Annotated

import torch

from deblur_avatar.artifacts.avatar import Avatar, composition_in_code
from deblur_avatar.artifacts.body import Body
from deblur_avatar.avatars.avatar import AvatarModel
from deblur_avatar.avatars.params import AvatarParams
from deblur_avatar.config.kinds import KindOf, Registry
from deblur_avatar.config.reading import parse

AVATARS: Registry[AvatarModel] = Registry(
    {
        "arah_small": "deblur_avatar.avatars.arah_small_avatar:ArahSmallAvatar",
        "gart": "deblur_avatar.avatars.gart_avatar:GartAvatar",
        "gauhuman": "deblur_avatar.avatars.gauhuman_avatar:GauhumanAvatar",
        "gomavatar": "deblur_avatar.avatars.gomavatar_avatar:GomavatarAvatar",
        "humannerf_small": "deblur_avatar.avatars.humannerf_small_avatar:HumannerfSmallAvatar",
        "networks": "deblur_avatar.avatars.networks_avatar:NetworksAvatar",
        "one_sided": "deblur_avatar.avatars.one_sided_avatar:OneSidedAvatar",
        "plain": "deblur_avatar.avatars.plain_avatar:PlainAvatar",
    }
)

# The section of any kind.
AnyAvatarParams = Annotated[AvatarParams, KindOf("kind", AVATARS)]


def avatar_from_artifact(avatar: Avatar, body: Body, device: torch.device) -> AvatarModel:
    """Rebuild the avatar that a stage saved.

    Raises:
        ConfigError: if its composition is not one this version knows.
        ArtifactError: if its networks are not those of the composition.
    """
    said = composition_in_code(avatar.model["params"])
    params = parse(AnyAvatarParams, said, "avatar model")
    return AVATARS[params.kind].from_artifact(avatar, params, body).to(device)
