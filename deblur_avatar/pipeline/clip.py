"""Every source in one form: the stage `clip`."""

import torch

from deblur_avatar.artifacts import Body, Clip, Reference
from deblur_avatar.config import MultiviewParams, StudioParams
from deblur_avatar.sources.multiview import load_multiview
from deblur_avatar.sources.studio.source import load_studio


def load_clip(
    params: StudioParams | MultiviewParams, body: Body, generator: torch.Generator
) -> tuple[Clip, Reference]:
    """Film or read one scene.

    Args:
        params: the scene's `clip` section; its class says which source.
        body: worn by a synthetic person; a real one has her own.
        generator: for what a source draws at random.

    Raises:
        ConfigError: for parameters that fit no footage, or footage that is not there.
    """
    if isinstance(params, StudioParams):
        return load_studio(params, body, generator)
    return load_multiview(params)
