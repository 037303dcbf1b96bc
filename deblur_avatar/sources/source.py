"""Source protocol: what every kind of footage does.

A source is its parameters, the section `clip` of a scene, with two methods. A new kind is a module
with such a class and a line in `sources/registry.py` (docs/extending.md).
"""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import UInt8
from torch import Tensor

from deblur_avatar.artifacts.body import Body
from deblur_avatar.artifacts.clip import Clip
from deblur_avatar.artifacts.reference import Reference

# Soft mattes of one person in consecutive frames of one camera.
Segment = Callable[[UInt8[Tensor, "F H W 3"]], UInt8[Tensor, "F H W"]]


@runtime_checkable
class Source(Protocol):
    """One scene's footage, wherever it comes from."""

    def load(
        self, body: Body, segment: Segment, generator: torch.Generator
    ) -> tuple[Clip, Reference]:
        """Make or read the clip, and the truth that only `evaluate` may see.

        Args:
            body: a synthetic person's, or the one that poses brought along are of.
            segment: finds a real person's mattes, where the footage has none.
            generator: for what is drawn at random.

        Raises:
            ConfigError: for parameters that fit no footage, or footage that is not there.
            ArtifactError: for footage that cannot be read.
        """
        ...

    def missing_files(self, where: str) -> tuple[str, ...]:
        """What of its files this machine lacks, a reason each; none if it can be loaded here.

        Args:
            where: the section's key in the parameter file, which reasons name.
        """
        ...
