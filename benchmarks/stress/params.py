"""Parameters of the stress suite: `stability/params.yaml`, typed and strict.

Defaults live there; the sections that it lacks are the root's.
"""

from typing import Annotated, Literal

from pydantic import Field

from deblur_avatar.config.section import NonNegative, Params
from deblur_avatar.sources.studio.source import StudioParams


class StabilitySceneParams(Params):
    """One small scene of the suite.

    `clip.motion` names a motion of `motions.py`. `cloth_m` is how far the clothes below the
    waist swing to either side, which no joint of the body explains; `pulled_m` how far the left
    arm pulls them. `networks` asks for a ceiling of an avatar with networks, too.
    """

    clip: StudioParams
    cloth_m: NonNegative
    pulled_m: NonNegative
    networks: bool


class SeverityParams(Params):
    """How bad one failure is: which scene, what is done to it, and how fitting is disturbed.

    `level` decides which recovery is asked for. `damage` names functions of `damage.py` with their
    amounts, applied in order. `fit` may hold `budget` (times the schedule), `seed` (another draw),
    `draws` (how many, from that one on, are averaged, instead of the suite's), `networks` (the
    avatar has the paper's networks), `blend` and `instants` (asked of methods that blend renders,
    or that have several instants an exposure), `no_oracle` (nothing is fitted to the sharp frames),
    `estimated_shutter` (its learning rate, with the prior's `shutter_weight`), `exposure_gain`,
    `start_noise` (radians, instead of the method's) and `degenerate` (share of the Gaussians that
    become degenerate).
    """

    scene: str
    level: Literal["mild", "severe"]
    damage: dict[str, float]
    fit: dict[str, float]


class ModeParams(Params):
    """One way to fail; severities from mild to bad."""

    title: str
    severities: Annotated[dict[str, SeverityParams], Field(min_length=1)]


class SelfCheckParams(Params):
    """Cases of the self-check's confusion table.

    `tuning` and `report` name scenes; every method is fitted to each. `damages` are names of
    `damage.py` or of `self_check_cases.py` with amounts that ruin an avatar.
    """

    methods: Annotated[tuple[str, ...], Field(min_length=1)]
    tuning: Annotated[tuple[str, ...], Field(min_length=1)]
    report: Annotated[tuple[str, ...], Field(min_length=1)]
    damages: Annotated[dict[str, float], Field(min_length=1)]
