"""Every source in one form: the stage `clip`."""

from typing import Annotated

import torch
from pydantic import Field

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.body_estimation.landmarks import PersonDetector
from deblur_avatar.sources.monocular import MonocularParams, load_monocular
from deblur_avatar.sources.multiview import MultiviewParams, load_multiview
from deblur_avatar.sources.studio.params import StudioParams
from deblur_avatar.sources.studio.source import load_studio
from deblur_avatar.sources.zju_mocap.params import ZjuMocapParams
from deblur_avatar.sources.zju_mocap.source import load_zju_mocap

ClipParams = Annotated[
    StudioParams | MultiviewParams | MonocularParams | ZjuMocapParams,
    Field(discriminator="source"),
]


def load_clip(
    params: StudioParams | MultiviewParams | MonocularParams | ZjuMocapParams,
    body: Body,
    *,
    detect: PersonDetector,
    generator: torch.Generator,
) -> tuple[Clip, Reference]:
    """Film or read one scene.

    Args:
        params: the scene's `clip` section; its class says which source.
        body: a synthetic person's, or the one that poses brought along are of.
        detect: finds a real person's mattes, where a source needs them.
        generator: for what a source draws at random.

    Raises:
        ConfigError: for parameters that fit no footage, or footage that is not there.
        ArtifactError: for footage that cannot be read.
    """
    if isinstance(params, StudioParams):
        return load_studio(params, body, generator)
    if isinstance(params, MonocularParams):
        return load_monocular(params, body, lambda frames: detect(frames).mattes)
    if isinstance(params, ZjuMocapParams):
        return load_zju_mocap(params, body)
    return load_multiview(params, lambda frames: detect(frames).mattes)
