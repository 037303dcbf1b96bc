"""Optimizer state that the next stage continues from."""

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from deblur_avatar.artifacts.storage import Artifact


@dataclass(frozen=True, kw_only=True)
class Checkpoint(Artifact):
    """What an optimizer remembers, so that the next stage goes on where the last one stopped."""

    schema: ClassVar[str] = "checkpoint/1"

    iteration: int
    tensors: dict[str, Tensor]
