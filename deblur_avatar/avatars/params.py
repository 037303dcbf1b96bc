"""Parameters of an avatar: which networks it is composed of."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from deblur_avatar.config.section import (
    Count,
    NonNegative,
    Params,
)

# Of the layers of a network: float32, or products of bfloat16 summed in float32.
Precision = Literal["float32", "bfloat16"]


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
    """Which parts an avatar is composed of.

    `precision` is that of the networks' layers; an avatar without networks states none.
    """

    precision: Precision | None = None
    nonrigid: NonRigidParams | None
    skinning: SkinningParams | None
    color: ColorParams | None

    @model_validator(mode="after")
    def _precision_of_networks(self) -> "ModelParams":
        networks = (self.nonrigid, self.skinning, self.color)
        has_networks = any(network is not None for network in networks)
        if has_networks and self.precision is None:
            raise ValueError("networks need a precision, float32 or bfloat16")
        if not has_networks and self.precision is not None:
            raise ValueError("an avatar without networks takes no precision; remove the key")
        return self
