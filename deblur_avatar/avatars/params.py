"""Parameters of an avatar: which networks it is composed of."""

from typing import Annotated

from pydantic import Field

from deblur_avatar.config.section import (
    Count,
    NonNegative,
    Params,
)


class NonRigidParams(Params):
    """The network that moves clothes with the pose."""

    bins: Count  # of the one-blob encoding, per axis
    hidden: tuple[Count, ...]
    codes: Annotated[int, Field(ge=0)]  # numbers handed on to the colours


class SkinningParams(Params):
    """The network that learns blend weights; None means the body's own."""

    hidden: tuple[Count, ...]
    pretrain: Annotated[int, Field(ge=0)]  # iterations on the body's own weights before anything


class ColorParams(Params):
    """The network that colours; None means one colour a Gaussian."""

    features: Count
    hidden: tuple[Count, ...]
    latent: Count
    view_noise_degrees: NonNegative


class ModelParams(Params):
    """Which parts an avatar is composed of."""

    nonrigid: NonRigidParams | None
    skinning: SkinningParams | None
    color: ColorParams | None
