"""Footage: every source in one form."""

import torch

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference
from deblur_avatar.body_estimation.landmarks import PersonDetector
from deblur_avatar.sources.registry import ClipParams
from deblur_avatar.sources.source import Source

__all__ = ["ClipParams", "load_clip"]


def load_clip(
    source: Source, body: Body, *, detect: PersonDetector, generator: torch.Generator
) -> tuple[Clip, Reference]:
    """Film or read one scene.

    Args:
        source: the scene's `clip` section.
        body: a synthetic person's, or the one that poses brought along are of.
        detect: finds a real person's mattes, where a source needs them.
        generator: for what a source draws at random.

    Raises:
        ConfigError: for parameters that fit no footage, or footage that is not there.
        ArtifactError: for footage that cannot be read.
    """
    return source.load(body, lambda frames: detect(frames).mattes, generator)
