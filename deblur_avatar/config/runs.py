"""Runs and warm-ups: what is trained, by names of scene, observations, start and method."""

from typing import Literal

from deblur_avatar.config.section import (
    Params,
)


class WarmupParams(Params):
    """A first avatar on one scene's frames."""

    scene: str
    observations: Literal["exact", "sharp", "blurred", "deblurred"]
    avatar: str


class RunParams(Params):
    """One method on one scene: which frames it sees and which warm-up it goes on from."""

    scene: str
    observations: Literal["exact", "sharp", "blurred", "deblurred"]
    avatar: str
    method: str
